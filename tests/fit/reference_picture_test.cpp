#include "fit/reference_picture.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "maths/srgb.hpp"
#include "painted_picture.hpp"

namespace facet::fit {
namespace {

/// Shows (x, y, 500 mm) at (x + 80, y + 60).
capture::Lens plate_lens() {
  capture::Lens lens;
  lens.width_px = 160;
  lens.height_px = 120;
  lens.fx_px = lens.fy_px = 500;
  lens.cx_px = 80;
  lens.cy_px = 60;
  return lens;
}

/// 500 mm behind the camera, 1 m from a plate at 500 mm.
capture::Lens projector() {
  capture::Lens lens = plate_lens();
  lens.camera_from_rig.translation().z() = 500;
  return lens;
}

mesh::Vertices plate_at(float z_mm) {
  mesh::Vertices plate(3, 4);
  plate << -40, 40, 40, -40, -30, -30, 30, 30, z_mm, z_mm, z_mm, z_mm;
  return plate;
}

mesh::Triangles plate_triangles() {
  mesh::Triangles triangles(3, 2);
  triangles << 0, 0, 1, 2, 2, 3;
  return triangles;
}

Eigen::Matrix3Xf towards_camera(Eigen::Index count) {
  return Eigen::Vector3f(0, 0, -1).replicate(1, count);
}

TEST(ReferencePicture, DrawsTheSkinWhereTheMeshIs) {
  const capture::Lens lens = plate_lens();
  const mesh::Vertices plate = plate_at(500);
  const mesh::Triangles triangles = plate_triangles();
  const std::vector<std::uint8_t> all(4, 1);
  Eigen::Matrix3Xf normals = Eigen::Matrix3Xf::Zero(3, 4);
  normals.row(2).setConstant(-1);
  const ProjectedLight dark({});  // nothing is known of the light
  const ReferencePicture reference(lens, painted(160, 120, texture), plate, normals, triangles, all, dark);
  const mesh::Vertices moved = plate.colwise() + Eigen::Vector3f(7, -4, 0);
  std::vector<std::uint8_t> drawn;
  const Frame now = painted(160, 120, [](float, float) { return 10.0F; });
  const Frame shown = reference.draw(now, moved, normals, all, dark, drawn);
  for (int y = 0; y < 120; ++y) {
    for (int x = 0; x < 160; ++x) {
      const bool inside = x > 48 && x < 126 && y > 27 && y < 85;
      const bool outside = x < 46 || x > 128 || y < 25 || y > 87;
      const int value = shown.row(y)[4 * x];
      if (inside) {
        ASSERT_NEAR(value, texture(static_cast<float>(x) - 7, static_cast<float>(y) + 4), 1.01F)
            << x << ", " << y;
        ASSERT_EQ(drawn[static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x)], 1);
      } else if (outside) {
        ASSERT_EQ(value, 10) << x << ", " << y;
        ASSERT_EQ(drawn[static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x)], 0);
      }
    }
  }
  // A vertex that is not seen takes its triangles with it.
  std::vector<std::uint8_t> hidden = all;
  hidden[1] = 0;
  reference.draw(now, moved, normals, hidden, dark, drawn);
  EXPECT_EQ(drawn[40 * 160 + 110], 0) << "the triangle at the hidden corner";
  EXPECT_EQ(drawn[70 * 160 + 60], 1) << "the other one";
}

TEST(ReferencePicture, DrawsWhatIsNearest) {
  // A small plate before the large one, drawn before it; both brighten from left to right in the reference.
  mesh::Vertices both(3, 8);
  both << plate_at(500), plate_at(400);
  both.rightCols(4).topRows<2>() *= 0.25F;
  mesh::Triangles triangles(3, 4);
  triangles << plate_triangles().array() + 4, plate_triangles();
  const std::vector<std::uint8_t> all(8, 1);
  const ProjectedLight unknown({});
  const ReferencePicture reference(plate_lens(), painted(160, 120, [](float x, float) { return x; }), both,
                                   towards_camera(8), triangles, all, unknown);
  mesh::Vertices moved = both;
  moved.rightCols(4).row(0).array() += 20;  // 25 px to the right
  std::vector<std::uint8_t> drawn;
  const Frame now = painted(160, 120, [](float, float) { return 10.0F; });
  const Frame shown = reference.draw(now, moved, towards_camera(8), all, unknown, drawn);
  EXPECT_NEAR(shown.row(60)[4 * 105], 80, 1) << "the small plate";
  EXPECT_NEAR(shown.row(60)[4 * 60], 60, 1) << "the large one";
}

/// Normals of the plate that turn away from left to right, by `most` on the right.
Eigen::Matrix3Xf turning(float most_rad) {
  Eigen::Matrix3Xf normals = towards_camera(4);
  for (const Eigen::Index right : {1, 2}) {
    normals.col(right) << std::sin(most_rad), 0, -std::cos(most_rad);
  }
  return normals;
}

/// What the camera sees of the plate at 500 mm, whose skin mirrors a tenth, in the projector's light and the
/// room's.
Frame lit_plate(const ProjectedLight& light, const Eigen::Matrix3Xf& normals, float projectors, float room) {
  return painted(160, 120, [&](float x, float y) {
    const float share = std::clamp((x - 40) / 80, 0.0F, 1.0F);
    const Eigen::Vector3f normal = ((1 - share) * normals.col(0) + share * normals.col(1)).normalized();
    const float given = 0.25F * projectors * light.at({x - 80, y - 60, 500}, normal) + room;
    return 255 * maths::encode_srgb(given);
  });
}

TEST(ReferencePicture, IsDrawnInTheLightOfNow) {
  ProjectedLight light({projector()});
  const mesh::Vertices plate = plate_at(500);
  const std::vector<std::uint8_t> all(4, 1);
  light.cast_shadows(plate, plate_triangles());
  const Frame now = painted(160, 120, [](float, float) { return 10.0F; });
  const Eigen::Matrix3Xf then = turning(1.2F);
  const Eigen::Matrix3Xf turned = turning(0.4F);
  std::vector<std::uint8_t> drawn;
  const ReferencePicture reference(plate_lens(), lit_plate(light, then, 1, 0.05F), plate, then,
                                   plate_triangles(), all, light);
  const Frame shown = reference.draw(now, plate, turned, all, light, drawn);
  const Frame expected = lit_plate(light, turned, 1, 0.05F);
  const Frame before = lit_plate(light, then, 1, 0.05F);
  for (const int x : {50, 80, 110}) {
    EXPECT_NEAR(shown.row(60)[4 * x], expected.row(60)[4 * x], 2) << x;
  }
  EXPECT_GT(expected.row(60)[4 * 110], before.row(60)[4 * 110] + 20) << "it tells";
  // The room's light is all that there is.
  const Frame even = lit_plate(light, then, 0, 0.2F);
  const ReferencePicture by_day(plate_lens(), even, plate, then, plate_triangles(), all, light);
  const Frame same = by_day.draw(now, plate, turned, all, light, drawn);
  for (const int x : {50, 80, 110}) {
    EXPECT_NEAR(same.row(60)[4 * x], even.row(60)[4 * x], 2) << x;
  }
}

TEST(ProjectedLight, CastsShadowsAndThins) {
  EXPECT_FALSE(ProjectedLight({}).is_known());
  ProjectedLight light({projector()});
  mesh::Vertices both(3, 8);
  both << plate_at(500), plate_at(400);
  both.rightCols(4).topRows<2>() *= 0.25F;  // a shadow of 11 x 8 mm about the middle of the large plate
  mesh::Triangles triangles(3, 4);
  triangles << plate_triangles(), plate_triangles().array() + 4;
  light.cast_shadows(both, triangles);
  const Eigen::Vector3f facing(0, 0, -1);
  const float dark = light.at({0, 0, 500}, facing);
  const float lit = light.at({30, 0, 500}, facing);
  EXPECT_EQ(dark, 0);
  EXPECT_NEAR(lit, 1, 0.01F) << "1 m away";
  EXPECT_GT(light.at({0, 0, 400}, facing), lit) << "nearer";
  EXPECT_EQ(light.at({30, 0, 500}, -facing), dark) << "turned away";
  const float rim = light.at({11, 0, 500}, facing);
  EXPECT_GT(rim, dark);
  EXPECT_LT(rim, lit);
}

}  // namespace
}  // namespace facet::fit
