// Maps of surfaces whose every pixel is known, and as OpenEXR and our reader of pictures read them back.

#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <gtest/gtest.h>

#include "exports/export.hpp"
#include "files/image_file.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/png_head.hpp"

namespace facet::take {
namespace {

constexpr int kSize = 61;  // odd, and no pixel centre on a vertex

/// A flat patch of 150 mm, u to x and v to y; what lies between vertices is linear.
class Maps : public ::testing::Test {
 protected:
  Maps() {
    for (Eigen::Index i = 0; i < frame.control_vertices_mm.cols(); ++i) {
      frame.control_vertices_mm(0, i) = 150.0F * (static_cast<float>(i % 9) / 8.0F - 0.5F);
      frame.control_vertices_mm(1, i) = 150.0F * (static_cast<float>(i / 9) / 8.0F - 0.5F);
      frame.control_vertices_mm(2, i) = 0;
    }
    std::fill(frame.displacements_mm.begin(), frame.displacements_mm.end(), 0.0F);
  }
  /// u and v of a pixel's centre.
  static Eigen::Vector2f at(int x, int y) {
    return {(static_cast<float>(x) + 0.5F) / kSize, 1.0F - (static_cast<float>(y) + 0.5F) / kSize};
  }
  template <typename Value>
  void displace(const Value& value) {
    const mesh::TextureCoordinates& uv = subject->hierarchy->texture_coordinates;
    for (Eigen::Index i = 0; i < uv.cols(); ++i) {
      frame.displacements_mm[static_cast<std::size_t>(i)] = value(uv(0, i), uv(1, i));
    }
  }
  static Eigen::Vector3f pixel(const exports::MapPicture& picture, int x, int y) {
    return Eigen::Map<const Eigen::Vector3f>(&picture.values[static_cast<std::size_t>(3 * (y * kSize + x))]);
  }

  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
  mesh::MeshFrame frame = test::patch_frame(1, subject, test::patch_albedo(*subject));
  exports::MapBaker baker{kSize};
  test::TemporaryFolder folder;
};

TEST_F(Maps, DisplacementIsThatOfThePlace) {
  displace([](float u, float v) { return 3 * u - 2 * v; });
  const exports::MapPicture& picture = baker.bake(frame, exports::MapKind::Displacement);
  ASSERT_EQ(picture.channels, 1);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      ASSERT_NEAR(picture.values[static_cast<std::size_t>(y * kSize + x)],
                  3 * at(x, y).x() - 2 * at(x, y).y(), 1e-4F)
          << x << " " << y;
    }
  }
}

TEST_F(Maps, ASlopeTiltsTheNormalAgainstItsRise) {
  displace([](float u, float v) { return 6 * u + 3 * v; });
  const Eigen::Vector3f expected = Eigen::Vector3f(-6.0F / 150, -3.0F / 150, 1).normalized();
  for (const exports::MapKind kind : {exports::MapKind::TangentNormal,
                                      exports::MapKind::ObjectNormal}) {  // the patch lies as the head does
    const exports::MapPicture& picture = baker.bake(frame, kind);
    for (int y = 5; y < kSize - 5; ++y) {  // the rims stay where they are
      for (int x = 5; x < kSize - 5; ++x) {
        ASSERT_LT((pixel(picture, x, y) - expected).norm(), 2e-3F) << x << " " << y;
      }
    }
  }
}

TEST_F(Maps, ASmoothSurfaceHasStraightTangentNormals) {
  frame = test::patch_frame(2, subject, nullptr);  // bent and rough, but without displacements
  frame.displacements_mm.clear();
  const exports::MapPicture& picture = baker.bake(frame, exports::MapKind::TangentNormal);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      ASSERT_LT((pixel(picture, x, y) - Eigen::Vector3f(0, 0, 1)).norm(), 1e-4F);
    }
  }
}

TEST_F(Maps, ChartsAreCarriedOnAndTheRestIsZero) {
  auto hierarchy = std::make_shared<mesh::Hierarchy>(*subject->hierarchy);
  hierarchy->texture_coordinates = 0.5F * hierarchy->texture_coordinates;  // the lower left quarter
  auto moved = std::make_shared<mesh::Subject>(*subject);
  moved->hierarchy = hierarchy;
  frame.subject = moved;
  std::fill(frame.displacements_mm.begin(), frame.displacements_mm.end(), 1.5F);
  const exports::MapPicture& picture = baker.bake(frame, exports::MapKind::Displacement);
  const auto value = [&](int x, int y) { return picture.values[static_cast<std::size_t>(y * kSize + x)]; };
  EXPECT_FLOAT_EQ(value(0, kSize - 1), 1.5F);
  EXPECT_FLOAT_EQ(value(kSize / 2 + 8, kSize - 1), 1.5F) << "8 pixels beyond the edge";
  EXPECT_EQ(value(kSize / 2 + 10, kSize - 1), 0.0F);
  EXPECT_EQ(value(0, 0), 0.0F);
}

TEST_F(Maps, ExrHoldsTheValues) {
  displace([](float u, float v) { return 3 * u - 2 * v; });
  const std::string file = (folder.path() / "map.exr").string();
  for (const exports::MapKind kind :
       {exports::MapKind::Displacement, exports::MapKind::ObjectNormal, exports::MapKind::Albedo}) {
    const exports::MapPicture picture = baker.bake(frame, kind);
    exports::write_map(picture, kind, exports::PictureFormat::Exr, file);
    Imf::InputFile reader(file.c_str());
    std::vector<float> values(picture.values.size());
    const std::vector<const char*> names =
        picture.channels == 1 ? std::vector<const char*>{"Y"} : std::vector<const char*>{"R", "G", "B"};
    Imf::FrameBuffer pixels;
    const std::size_t step = sizeof(float) * names.size();
    for (std::size_t channel = 0; channel < names.size(); ++channel) {
      pixels.insert(names[channel], Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values.data() + channel),
                                               step, step * kSize));
    }
    reader.setFrameBuffer(pixels);
    reader.readPixels(0, kSize - 1);
    EXPECT_EQ(values, picture.values);
  }
}

TEST_F(Maps, PngHasSixteenBits) {
  displace([](float u, float v) { return 30 * u - 2 * v; });  // beyond the range at the right
  const std::string file = (folder.path() / "map.png").string();
  exports::MapPicture picture = baker.bake(frame, exports::MapKind::Displacement);
  exports::write_map(picture, exports::MapKind::Displacement, exports::PictureFormat::Png, file);
  EXPECT_EQ(test::png_head_of(file), (test::PngHead{kSize, kSize, 16, false}));
  const auto grey = files::read_image<std::uint16_t>(file);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const float mm =
          std::min(picture.values[static_cast<std::size_t>(y * kSize + x)], exports::kDisplacementRange_mm);
      ASSERT_NEAR(
          (static_cast<float>(grey.values[3 * static_cast<std::size_t>(y * kSize + x)]) / 65535 - 0.5F) * 2 *
              exports::kDisplacementRange_mm,
          mm, 2e-4F);
    }
  }
  picture = baker.bake(frame, exports::MapKind::Albedo);
  exports::write_map(picture, exports::MapKind::Albedo, exports::PictureFormat::Png, file);
  EXPECT_EQ(test::png_head_of(file), (test::PngHead{kSize, kSize, 16, true}));
  const auto colour = files::read_image<std::uint16_t>(file);
  const Eigen::Vector3f linear = pixel(picture, 30, 20);
  for (int channel = 0; channel < 3; ++channel) {
    const double srgb = 1.055 * std::pow(static_cast<double>(linear[channel]), 1 / 2.4) - 0.055;
    EXPECT_NEAR(colour.values[static_cast<std::size_t>(3 * (20 * kSize + 30) + channel)], 65535 * srgb, 1);
  }
}

}  // namespace
}  // namespace facet::take
