#include "refine/room_light.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "maths/srgb.hpp"
#include "refine/refiner.hpp"
#include "support/gpu.hpp"

namespace facet::refine {
namespace {

using shaders::vec4;

constexpr int kColumns = 32;
constexpr int kRows = 40;
constexpr float kAlbedo = 0.4F;

/// A mask of a face: a dome with a nose that throws shadows, 128 x 160 mm, 600 mm before the camera.
struct Mask {
  Mask() {
    mesh::ControlMesh control;
    control.vertex_count = (kColumns + 1) * (kRows + 1);
    control.refinable.assign(static_cast<std::size_t>(control.vertex_count), 1);
    control_mm.resize(3, control.vertex_count);
    mesh::TextureCoordinates px(2, control.vertex_count);
    for (int row = 0; row <= kRows; ++row) {
      for (int column = 0; column <= kColumns; ++column) {
        const auto x = static_cast<float>(4 * column - 2 * kColumns);
        const auto y = static_cast<float>(4 * row - 2 * kRows);
        const float dome = 60 * std::sqrt(std::max(0.0F, 1 - x * x / 9000 - y * y / 12000));
        const float nose = 28 * std::exp(-x * x / 130 - y * y / 500);
        const int i = row * (kColumns + 1) + column;
        control_mm.col(i) << x, y, dome + nose;
        px.col(i) << x, y;
      }
    }
    control.texture_coordinates = px;
    control.quads.resize(4, Eigen::Index{kColumns} * kRows);
    for (int row = 0; row < kRows; ++row) {
      for (int column = 0; column < kColumns; ++column) {
        const int i = row * (kColumns + 1) + column;
        control.quads.col(row * kColumns + column) << i, i + 1, i + kColumns + 2, i + kColumns + 1;
      }
    }
    mesh::HierarchyOptions options;
    options.max_levels = 1;
    hierarchy = mesh::build_hierarchy(
        control, px, std::vector<std::uint8_t>(static_cast<std::size_t>(control.vertex_count), 1), options);
    mesh::apply(hierarchy->levels.front().from_coarser, control_mm, head_mm);
    mesh::vertex_normals(head_mm, hierarchy->levels.front().triangles, head_normals);
  }

  const mesh::Triangles& triangles() const { return hierarchy->levels.front().triangles; }

  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  mesh::Vertices control_mm;  ///< head frame: x right, y up, z out of the face
  mesh::Vertices head_mm;     ///< of M0
  Eigen::Matrix3Xf head_normals;
};

const Mask& mask() {
  static const Mask made;
  return made;
}

/// Whether the ray from a point meets the mask.
bool hidden(const Mask& of, const Eigen::Vector3f& from, const Eigen::Vector3f& towards) {
  for (Eigen::Index t = 0; t < of.triangles().cols(); ++t) {
    const Eigen::Vector3f a = of.head_mm.col(of.triangles()(0, t));
    const Eigen::Vector3f ab = of.head_mm.col(of.triangles()(1, t)) - a;
    const Eigen::Vector3f ac = of.head_mm.col(of.triangles()(2, t)) - a;
    const Eigen::Vector3f p = towards.cross(ac);
    const float determinant = ab.dot(p);
    if (std::abs(determinant) < 1e-9F) {
      continue;
    }
    const Eigen::Vector3f s = (from - a) / determinant;
    const float u = s.dot(p);
    const Eigen::Vector3f q = s.cross(ab);
    const float v = towards.dot(q);
    if (u >= 0 && v >= 0 && u + v <= 1 && ac.dot(q) > 0) {
      return true;
    }
  }
  return false;
}

/// A room with one distant lamp and an even rest.
struct Room {
  Eigen::Vector3f lamp = Eigen::Vector3f(0.8F, 0.25F, 0.55F).normalized();  ///< shading frame
  float strength = 1.2F;
  float even = 0.15F;
};

struct View {
  float yaw_rad = 0;
  float exposure = 1;

  Eigen::Matrix3f shading_from_head() const {
    return Eigen::AngleAxisf(yaw_rad, Eigen::Vector3f::UnitY()).toRotationMatrix();
  }
  Eigen::Vector3f place(const Eigen::Vector3f& head_mm) const {
    return shading_from_head() * head_mm - Eigen::Vector3f(0, 0, 600);
  }
};

/// [M0's vertex count] what the room gives every vertex.
std::vector<float> true_irradiance(const Room& room, const View& view) {
  const Mask& head = mask();
  const Eigen::Vector3f lamp = view.shading_from_head().transpose() * room.lamp;
  std::vector<float> out;
  for (Eigen::Index v = 0; v < head.head_mm.cols(); ++v) {
    const Eigen::Vector3f normal = head.head_normals.col(v);
    const bool shadow = hidden(head, head.head_mm.col(v) + 0.5F * normal, lamp);
    out.push_back(room.even + (shadow ? 0 : room.strength * std::max(0.0F, normal.dot(lamp))));
  }
  return out;
}

constexpr int kWidth = 480;
constexpr int kHeight = 480;

CameraIntrinsics camera() {
  return {1200, 1200, kWidth / 2.0F, kHeight / 2.0F, kWidth, kHeight};
}

/// The mask under a light, shaded from vertex to vertex.
Frame picture(const std::vector<float>& irradiance, const View& view) {
  const Mask& head = mask();
  auto pixels = std::make_shared<std::uint8_t[]>(static_cast<std::size_t>(4 * kWidth * kHeight));
  std::vector<float> depths(static_cast<std::size_t>(kWidth * kHeight), 1e9F);
  for (Eigen::Index t = 0; t < head.triangles().cols(); ++t) {
    Eigen::Matrix3f corners;  // x, y in px and depth
    Eigen::Vector3f light;
    for (Eigen::Index c = 0; c < 3; ++c) {
      const std::int32_t vertex = head.triangles()(c, t);
      const Eigen::Vector3f p = view.place(head.head_mm.col(vertex));
      corners.col(c) << camera().fx * p.x() / -p.z() + camera().cx, camera().fy * p.y() / p.z() + camera().cy,
          -p.z();
      light[c] = irradiance[static_cast<std::size_t>(vertex)];
    }
    Eigen::Matrix3f barycentric = corners;
    barycentric.row(2).setOnes();
    const float area = barycentric.determinant();
    if (std::abs(area) < 1e-6F) {
      continue;
    }
    const Eigen::Matrix3f inverse = barycentric.inverse();
    const Eigen::Vector2i low = corners.topRows<2>().rowwise().minCoeff().array().ceil().cast<int>();
    const Eigen::Vector2i high = corners.topRows<2>().rowwise().maxCoeff().array().floor().cast<int>();
    for (int y = std::max(0, low.y()); y <= std::min(kHeight - 1, high.y()); ++y) {
      for (int x = std::max(0, low.x()); x <= std::min(kWidth - 1, high.x()); ++x) {
        const Eigen::Vector3f b = inverse * Eigen::Vector3f(static_cast<float>(x), static_cast<float>(y), 1);
        const auto at = static_cast<std::size_t>(y * kWidth + x);
        const float depth = b.dot(corners.row(2));
        if (b.minCoeff() < -1e-4F || depth >= depths[at]) {
          continue;
        }
        depths[at] = depth;
        const float linear = std::clamp(view.exposure * kAlbedo * b.dot(light), 0.0F, 1.0F);
        const auto value = static_cast<std::uint8_t>(std::lround(255 * maths::encode_srgb(linear)));
        std::fill_n(pixels.get() + 4 * at, 3, value);
        pixels.get()[4 * at + 3] = 255;
      }
    }
  }
  Frame out;
  out.width_px = kWidth;
  out.height_px = kHeight;
  out.stride_bytes = std::size_t{4} * kWidth;
  out.pixels = pixels;
  return out;
}

class RoomLightTest : public ::testing::Test {
 protected:
  RoomLightTest()
      : light_(mask().hierarchy, std::vector<float>(static_cast<std::size_t>(mask().head_mm.cols()), 1),
               mesh::Vertices::Constant(3, mask().head_mm.cols(), kAlbedo)) {}

  void look(const Frame& frame, const View& view) {
    std::vector<vec4> control;
    for (Eigen::Index v = 0; v < mask().control_mm.cols(); ++v) {
      const Eigen::Vector3f p = view.place(mask().control_mm.col(v));
      control.push_back({p.x(), p.y(), p.z(), 0});
    }
    light_.look(frame, camera(), control, view.shading_from_head());
  }
  void look(const Room& room, const View& view) { look(picture(true_irradiance(room, view), view), view); }

  /// a + b . n of every vertex at its coarse normal.
  std::vector<float> found(const View& view) const {
    const Eigen::Matrix3Xf normals = view.shading_from_head() * mask().head_normals;
    std::vector<float> out;
    for (std::size_t v = 0; v < light_.irradiance().size(); ++v) {
      const vec4& e = light_.irradiance()[v];
      const auto n = normals.col(static_cast<Eigen::Index>(v));
      out.push_back(e.x + e.y * n.x() + e.z * n.y() + e.w * n.z());
    }
    return out;
  }

  struct Error {
    float middle = 0;  ///< median over the vertices that face the camera, relative to the mean irradiance
    float wide = 0;    ///< the 90th percentile
  };
  Error error(const Room& room, const View& view) const {
    const std::vector<float> truth = true_irradiance(room, view);
    const std::vector<float> mine = found(view);
    const Eigen::Matrix3Xf normals = view.shading_from_head() * mask().head_normals;
    std::vector<float> errors;
    float mean = 0;
    for (std::size_t v = 0; v < truth.size(); ++v) {
      if (normals(2, static_cast<Eigen::Index>(v)) > 0.5F) {
        errors.push_back(std::abs(mine[v] - view.exposure * truth[v]));
        mean += view.exposure * truth[v];
      }
    }
    mean /= static_cast<float>(errors.size());
    std::sort(errors.begin(), errors.end());
    return {errors[errors.size() / 2] / mean, errors[errors.size() * 9 / 10] / mean};
  }

  RoomLight light_;
};

TEST(HeadVisibilityTest, SeesPastTheHeadAlone) {
  const Mask& head = mask();
  const light::HeadVisibility visibility(head.head_mm, head.head_normals, head.triangles());
  int judged = 0;
  int wrong = 0;
  for (int d = 0; d < light::kRoomDirections; d += 7) {
    const Eigen::Vector3f direction = light::room_directions().col(d);
    for (Eigen::Index v = 0; v < head.head_mm.cols(); v += 5) {
      const std::uint8_t seen = visibility.of_direction(d)[v];
      if (head.head_normals.col(v).dot(direction) < 0.2F || (seen > 25 && seen < 230)) {
        continue;  // it turns away, or stands at a shadow's edge
      }
      ++judged;
      wrong +=
          hidden(head, head.head_mm.col(v) + head.head_normals.col(v), direction) != (seen < 128) ? 1 : 0;
    }
  }
  EXPECT_GT(judged, 2000);
  EXPECT_LT(wrong, judged / 50) << "of " << judged;
}

TEST(HeadVisibilityTest, TurnedLampsKeepTheirStrengthAndDirection) {
  EXPECT_NEAR((light::room_directions().colwise().norm().array() - 1).abs().maxCoeff(), 0, 1e-5);
  const Eigen::Matrix3f turn =
      Eigen::AngleAxisf(0.7F, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  const Eigen::MatrixXd turned = light::turned_lamps(turn);
  EXPECT_NEAR((turned.colwise().sum().array() - 1).abs().maxCoeff(), 0, 1e-9);
  for (int d = 0; d < light::kRoomDirections; ++d) {
    const Eigen::Vector3f mean = (light::room_directions() * turned.col(d).cast<float>()).normalized();
    EXPECT_GT(mean.dot(turn * light::room_directions().col(d)), std::cos(5 * std::numbers::pi_v<float> / 180))
        << d;
  }
}

TEST_F(RoomLightTest, FindsALampAndTheShadowOfTheNose) {
  const Room room;
  const View front;
  look(room, front);
  const Error found_error = error(room, front);
  EXPECT_LT(found_error.middle, 0.04F);
  EXPECT_LT(found_error.wide, 0.15F);
  EXPECT_GT(light_.believed(), 0.8);
  // Where the nose hides the lamp the skin faces it all the same: no light that knows the normal alone is
  // dark there.
  const Eigen::Vector3f lamp = room.lamp;
  double shadowed = 0;
  double lit = 0;
  int shadowed_count = 0;
  int lit_count = 0;
  const std::vector<float> mine = found(front);
  for (Eigen::Index v = 0; v < mask().head_mm.cols(); ++v) {
    const Eigen::Vector3f normal = mask().head_normals.col(v);
    if (std::abs(normal.dot(lamp) - 0.45F) > 0.2F || normal.z() < 0.5F) {
      continue;
    }
    const bool hides = hidden(mask(), mask().head_mm.col(v) + 0.5F * normal, lamp);
    (hides ? shadowed : lit) += static_cast<double>(mine[static_cast<std::size_t>(v)]);
    ++(hides ? shadowed_count : lit_count);
  }
  ASSERT_GT(shadowed_count, 8);
  ASSERT_GT(lit_count, 8);
  EXPECT_LT(shadowed / shadowed_count, 0.6 * lit / lit_count);
}

TEST_F(RoomLightTest, TheLampStaysWhileTheHeadTurns) {
  const Room room;
  look(room, {-0.35F});  // found in a turned head's frame
  const View turned{0.3F};
  look(Frame{}, turned);  // no picture: what is known of the room alone
  const Error there = error(room, turned);
  EXPECT_LT(there.middle, 0.12F);
  EXPECT_LT(there.wide, 0.4F);
}

TEST_F(RoomLightTest, ATurnTellsMoreThanOneFrame) {
  const Room room;
  look(room, {-0.35F});
  const View turned{0.3F};
  look(Frame{}, turned);
  const Error one = error(room, turned);
  for (int frame = 1; frame <= 16; ++frame) {
    look(room, {-0.35F + 0.03F * static_cast<float>(frame)});
  }
  look(Frame{}, turned);
  const Error many = error(room, turned);
  EXPECT_LT(many.middle, one.middle);
  EXPECT_LT(many.wide, one.wide);
}

TEST_F(RoomLightTest, FollowsTheExposureAtOnce) {
  const Room room;
  look(room, {});
  const View darker{0.05F, 0.6F};
  look(room, darker);
  const Error there = error(room, darker);
  EXPECT_LT(there.middle, 0.05F);
  EXPECT_LT(there.wide, 0.2F);
}

TEST_F(RoomLightTest, FindsTheLightAgainAfterALampWasMoved) {
  Room room;
  for (int frame = 0; frame < 3; ++frame) {
    look(room, {});
  }
  room.lamp = Eigen::Vector3f(-0.8F, 0.3F, 0.5F).normalized();
  for (int frame = 0; frame < 8; ++frame) {
    look(room, {});
  }
  const Error there = error(room, {});
  EXPECT_LT(there.middle, 0.05F);
  EXPECT_LT(there.wide, 0.2F);
}

/// What covers most of the face for a second is no light, and what was known is there when it goes.
TEST_F(RoomLightTest, AHandBeforeTheFaceIsNoLight) {
  const Room room;
  for (int frame = 0; frame < 3; ++frame) {
    look(room, {});
  }
  Frame covered = picture(true_irradiance(room, {}), {});
  auto pixels = std::make_shared<std::uint8_t[]>(static_cast<std::size_t>(4 * kWidth * kHeight));
  std::copy_n(covered.pixels.get(), std::size_t{4} * kWidth * kHeight, pixels.get());
  for (int y = kHeight / 4; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      std::fill_n(pixels.get() + std::ptrdiff_t{4} * (y * kWidth + x), 3,
                  static_cast<std::uint8_t>((x / 9 + y / 7) % 2 * 200));
    }
  }
  covered.pixels = pixels;
  for (int frame = 0; frame < 20; ++frame) {
    look(covered, {});
  }
  look(room, {});
  const Error there = error(room, {});
  EXPECT_LT(there.middle, 0.05F);
  EXPECT_LT(there.wide, 0.2F);
}

bool says_nothing(const std::vector<vec4>& irradiance) {
  return std::all_of(irradiance.begin(), irradiance.end(),
                     [](const vec4& e) { return e.x == 0 && e.y == 0 && e.z == 0 && e.w == 0; });
}

TEST_F(RoomLightTest, SaysNothingWithoutAPicture) {
  look(Frame{}, {});
  EXPECT_TRUE(says_nothing(light_.irradiance()));
  const std::vector<float> dark(static_cast<std::size_t>(mask().head_mm.cols()), 0);
  look(picture(dark, {}), {});
  EXPECT_TRUE(says_nothing(light_.irradiance()));
}

TEST_F(RoomLightTest, SaysNothingOfABrokenMeshAndGoesOn) {
  const Room room;
  const Frame frame = picture(true_irradiance(room, {}), {});
  for (const float broken :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e7F}) {
    std::vector<vec4> control;
    for (Eigen::Index v = 0; v < mask().control_mm.cols(); ++v) {
      const Eigen::Vector3f p = View{}.place(mask().control_mm.col(v));
      control.push_back({v == 77 ? broken : p.x(), p.y(), p.z(), 0});
    }
    light_.look(frame, camera(), control, Eigen::Matrix3f::Identity());
    EXPECT_TRUE(says_nothing(light_.irradiance())) << broken;
  }
  look(room, {});
  EXPECT_LT(error(room, {}).middle, 0.04F);
}

/// A face of which a corner of the picture shows a few vertices says nothing of a room.
TEST_F(RoomLightTest, AFaceAtThePicturesEdgeIsTooLittle) {
  Frame tiny = picture(true_irradiance(Room{}, {}), {});
  tiny.width_px = 150;
  tiny.height_px = 150;
  look(tiny, {});
  EXPECT_TRUE(says_nothing(light_.irradiance()));
}

TEST_F(RoomLightTest, TheSameFramesGiveTheSameBits) {
  RoomLight other(mask().hierarchy, std::vector<float>(static_cast<std::size_t>(mask().head_mm.cols()), 1),
                  mesh::Vertices::Constant(3, mask().head_mm.cols(), kAlbedo));
  std::swap(light_, other);
  std::vector<std::vector<vec4>> runs;
  for (int run = 0; run < 2; ++run) {
    for (int frame = 0; frame < 10; ++frame) {
      look(Room{}, {0.03F * static_cast<float>(frame)});
    }
    runs.push_back(light_.irradiance());
    std::swap(light_, other);
  }
  for (std::size_t v = 0; v < runs[0].size(); ++v) {
    const vec4& a = runs[0][v];
    const vec4& b = runs[1][v];
    EXPECT_TRUE(a.x == b.x && a.y == b.y && a.z == b.z && a.w == b.w) << v;
  }
}

/// The refiner with the lamps and without: the mask is its own coarse mesh, so that every displacement is an
/// error.
class ShadowTest : public facet::test::GpuTest {
 protected:
  double relief_mm(RoomLamps lamps) {
    RefinerConfig config;
    config.room_lamps = lamps;
    config.weights.displacement_coarse_known = config.weights.displacement_coarse;  // or it holds both back
    Refiner refiner(context(), config);
    const auto count = static_cast<std::size_t>(mask().hierarchy->control_vertex_count);
    SubjectSetup subject{mask().hierarchy, mesh::Vertices::Constant(3, mask().control_mm.cols(), kAlbedo),
                         std::vector<std::uint8_t>(count, 1)};
    subject.known_shape = true;
    refiner.set_subject(subject);
    RefineOutput output;
    double squares = 0;
    for (int frame = 0; frame < 4; ++frame) {
      const View view{-0.3F + 0.1F * static_cast<float>(frame)};
      RefineInput input;
      input.image = picture(true_irradiance(Room{}, view), view);
      input.camera = camera();
      const Eigen::Matrix3f half_turn = Eigen::Vector3f(1, -1, -1).asDiagonal();
      input.camera_from_head.linear() = half_turn * view.shading_from_head();
      input.camera_from_head.translation() << 0, 0, 600;
      input.control_vertices_mm = &mask().control_mm;
      refiner.submit(input);
      EXPECT_EQ(refiner.collect(output), RefineOutcome::Refined) << output.failure;
    }
    for (const float d : output.displacements_mm) {
      squares += static_cast<double>(d) * static_cast<double>(d);
    }
    return std::sqrt(squares / static_cast<double>(output.displacements_mm.size()));
  }
};

TEST_F(ShadowTest, TheShadowOfTheNoseIsNoShape) {
  const double without = relief_mm(RoomLamps::Never);
  const double with = relief_mm(RoomLamps::KnownShapes);
  EXPECT_GT(without, 0.05);
  EXPECT_LT(with, 0.6 * without) << without;
}

}  // namespace
}  // namespace facet::refine
