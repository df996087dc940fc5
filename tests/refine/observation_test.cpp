#include "refine/observation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "device_level.hpp"
#include "facet/error.hpp"
#include "support/gpu.hpp"

namespace facet::refine {
namespace {

using ::testing::HasSubstr;

using shaders::vec4;
using shaders::refine::FrameParameters;
using test::kTail;

using RefineObservation = facet::test::GpuTest;

float half_to_float(std::uint16_t half) {
  const int exponent = (half >> 10) & 31;
  const float mantissa = static_cast<float>(half & 1023) / 1024;
  const float size = exponent == 0 ? std::ldexp(mantissa, -14) : std::ldexp(1 + mantissa, exponent - 15);
  return (half & 0x8000) != 0 ? -size : size;
}

float srgb_to_linear(std::uint8_t value) {
  const float s = static_cast<float>(value) / 255;
  return s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
}

Frame random_frame(int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> value(0, 255);
  Frame out;
  out.width_px = width;
  out.height_px = height;
  out.stride_bytes = static_cast<std::size_t>(width) * 4 + 12;
  auto pixels = std::make_shared<std::uint8_t[]>(out.stride_bytes * static_cast<std::size_t>(height));
  for (std::size_t i = 0; i < out.stride_bytes * static_cast<std::size_t>(height); ++i) {
    pixels.get()[i] = static_cast<std::uint8_t>(value(random));
  }
  out.pixels = pixels;
  return out;
}

FrameParameters parameters_of(const ImagePyramid& pyramid) {
  FrameParameters out{};
  const std::vector<vec4> behind_the_camera{{0, 0, 1, 0}};
  set_frame_parameters(pyramid, {100, 100, 10, 10, pyramid.width_px, pyramid.height_px}, behind_the_camera,
                       out);
  return out;
}

gpu::Buffer upload_parameters(gpu::Context& context, const FrameParameters& parameters) {
  gpu::Buffer out(context, sizeof(FrameParameters), gpu::Memory::Upload, "frame parameters");
  out.mapped_as<FrameParameters>()[0] = parameters;
  return out;
}

/// Fills the levels that linear_image makes with one colour.
void fill_linear(gpu::Context& context, const ImagePyramid& pyramid, std::uint32_t half_pair) {
  gpu::Buffer colour(context, pyramid.linear.level_bytes(0), gpu::Memory::Device, "fill");
  gpu::run_now(context, "fill", [&](gpu::Batch& batch) {
    batch.fill(colour, half_pair);
    for (const std::uint32_t mip : {0U, 1U, 2U}) {
      batch.copy(colour, pyramid.linear, mip);
    }
  });
}

std::vector<float> read_linear(gpu::Context& context, const ImagePyramid& pyramid, std::uint32_t mip = 0) {
  gpu::Buffer out(context, pyramid.linear.level_bytes(mip), gpu::Memory::Readback, "linear read back");
  gpu::run_now(context, "read", [&](gpu::Batch& batch) { batch.copy(pyramid.linear, mip, out); });
  std::vector<float> values;
  for (const std::uint16_t half : out.mapped_as<std::uint16_t>()) {
    values.push_back(half_to_float(half));
  }
  return values;
}

TEST_F(RefineObservation, APictureTooLargeForTheDeviceIsNamed) {
  constexpr int kWidth_px = 16384;
  const auto height_px = static_cast<int>(context().info().max_storage_buffer_bytes / 4 / kWidth_px + 1);
  try {
    const ImagePyramid pyramid(context(), kWidth_px, height_px);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::NoDevice);
    EXPECT_THAT(error.what(),
                HasSubstr("of " + std::to_string(kWidth_px) + "x" + std::to_string(height_px) + " px"));
  }
}

TEST_F(RefineObservation, APictureIsUploadedAsFarAsTheFaceReaches) {
  for (const auto& [width, height] : {std::pair{127, 93}, std::pair{2500, 31}}) {
    SCOPED_TRACE(testing::Message() << width << " x " << height);
    const Frame first = random_frame(width, height, 7);
    const Frame second = random_frame(width, height, 8);
    ImagePyramid pyramid(context(), width, height);
    FrameParameters parameters = parameters_of(pyramid);
    // In the middle, and beyond the picture's last pixels.
    const FaceRegion middle{{8, 4}, {60, 12}};
    const FaceRegion corner{
        {64, 8}, {static_cast<int>(pyramid.linear.width_px()), static_cast<int>(pyramid.linear.height_px())}};
    const auto pixel = [&](const std::uint8_t* bytes, std::size_t stride, int x, int y) {
      std::uint32_t value = 0;
      std::memcpy(&value, bytes + static_cast<std::size_t>(y) * stride + 4 * static_cast<std::size_t>(x), 4);
      return value;
    };
    for (const FaceRegion& region : {middle, corner}) {
      pyramid.filled = false;
      upload_picture(pyramid, region, first, parameters);  // all of the first
      upload_picture(pyramid, region, second, parameters);
      const auto* uploaded = reinterpret_cast<const std::uint8_t*>(pyramid.pixels.buffer.mapped().data());
      const auto row_bytes = 4 * static_cast<std::size_t>(width);
      int wrong = 0;
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          const Eigen::Array2i at(x, y);
          const bool inside = (at >= region.low_px * pyramid.reduction).all() &&
                              (at < region.high_px * pyramid.reduction).all();
          const Frame& expected = inside ? second : first;
          wrong +=
              pixel(uploaded, row_bytes, x, y) != pixel(expected.pixels.get(), expected.stride_bytes, x, y)
                  ? 1
                  : 0;
        }
      }
      EXPECT_EQ(wrong, 0);
    }
  }
}

TEST_F(RefineObservation, LinearImageAgreesWithTheScalarOneAndStaysInItsRegion) {
  for (const auto& [width, height] : {std::pair{13, 127}, std::pair{127, 13}, std::pair{2500, 5}}) {
    SCOPED_TRACE(testing::Message() << width << " x " << height);
    const Frame frame = random_frame(width, height, 7);
    const ImagePyramid pyramid(context(), width, height);
    ASSERT_EQ(pyramid.reduction, width > 2048 ? 2 : 1);
    pyramid.write(frame);
    FrameParameters parameters = parameters_of(pyramid);
    const auto linear_width = static_cast<int>(pyramid.linear.width_px());
    const auto linear_height = static_cast<int>(pyramid.linear.height_px());
    parameters.region_px = {4, 0, linear_width - 4, linear_height};
    const gpu::Buffer uniform = upload_parameters(context(), parameters);
    constexpr std::uint32_t kHalfThrees = 0x42004200;
    fill_linear(context(), pyramid, kHalfThrees);
    const ObservationKernels kernels(context());
    gpu::run_now(context(), "image", [&](gpu::Batch& batch) {
      kernels.record_image(batch, pyramid, uniform);
      kernels.record_mips(batch, pyramid, uniform);
    });

    const std::vector<float> found = read_linear(context(), pyramid);
    const int k = pyramid.reduction;
    for (int y = 0; y < linear_height; ++y) {
      for (int x = 0; x < linear_width; ++x) {
        const std::size_t at = 4 * static_cast<std::size_t>(y * linear_width + x);
        if (x < 4 || x >= linear_width - 4) {
          ASSERT_EQ(found[at], 3) << "outside the region at " << x << ", " << y;
          continue;
        }
        bool saturated = false;
        std::array<float, 3> sum{};
        for (int v = 0; v < k; ++v) {
          for (int u = 0; u < k; ++u) {
            const std::uint8_t* pixel =
                frame.row(std::min(y * k + v, height - 1)) + 4 * std::min(x * k + u, width - 1);
            for (std::size_t c = 0; c < 3; ++c) {
              sum[c] += srgb_to_linear(pixel[c]) / static_cast<float>(k * k);
              saturated = saturated || pixel[c] > 250;
            }
          }
        }
        for (std::size_t c = 0; c < 3; ++c) {
          // Half precision, which lavapipe cuts off instead of rounding: one part in 1024. Its pow is good to
          // 1e-5.
          ASSERT_NEAR(found[at + c], sum[c], 1e-3F * sum[c] + 2e-5F) << x << ", " << y;
        }
        ASSERT_EQ(found[at + 3], saturated ? 0 : 1) << x << ", " << y;
      }
    }
    std::vector<float> above = found;
    ASSERT_EQ(pyramid.linear.level_count(), 6U);
    for (std::uint32_t mip = 1; mip < pyramid.linear.level_count(); ++mip) {
      const std::vector<float> mean = read_linear(context(), pyramid, mip);
      const auto above_width = static_cast<int>(pyramid.linear.width_px(mip - 1));
      const auto mip_width = static_cast<int>(pyramid.linear.width_px(mip));
      ASSERT_EQ(above_width, 2 * mip_width) << "whatever the source's size is";
      // Half and quarter size are made of the region's pixels alone, smaller ones wherever it touches them.
      const int outside = mip <= 2 ? 4 >> mip : 0;
      for (int y = 0; y < static_cast<int>(pyramid.linear.height_px(mip)); ++y) {
        for (int x = outside; x < mip_width - outside; ++x) {
          for (int c = 0; c < 4; ++c) {
            float sum = 0;
            for (const int i : {0, 1, above_width, above_width + 1}) {
              sum += above[static_cast<std::size_t>(4 * (2 * y * above_width + 2 * x + i) + c)];
            }
            ASSERT_NEAR(mean[static_cast<std::size_t>(4 * (y * mip_width + x) + c)], sum / 4, 1e-3F)
                << mip << ": " << x << ", " << y;
          }
        }
      }
      above = mean;
    }
  }
}

TEST_F(RefineObservation, FrameParametersCoverTheFace) {
  const ImagePyramid pyramid(context(), 640, 480);
  const CameraIntrinsics camera{500, 500, 320, 240, 640, 480};
  const std::vector<vec4> vertices{{-100, -80, -1000, 0}, {100, 120, -1000, 0}, {0, 0, 50, 0}};
  FrameParameters out{};
  const FaceRegion region = set_frame_parameters(pyramid, camera, vertices, out);
  // x 270 to 370, y 180 to 280 (up is down in the image), and the margin to whole blocks.
  EXPECT_EQ(region.low_px.x(), 270 - 50);
  EXPECT_EQ(region.high_px.x(), 370 + 50);
  EXPECT_EQ(region.low_px.y(), 180 - 48);
  EXPECT_EQ(region.high_px.y(), 280 + 48);
  const float map_x = 270 * out.depth_from_px.x + out.depth_from_px.z;
  const float map_end = 370 * out.depth_from_px.x + out.depth_from_px.z;
  EXPECT_NEAR(map_x, 1, 1e-3);
  EXPECT_NEAR(map_end, OcclusionMap::size_px - 1, 1e-3);
}

struct TwoTriangles {
  // One triangle 600 mm away, a smaller one 20 mm before it.
  std::vector<vec4> positions{{-60, -60, -600, 0}, {60, -51, -600, 0}, {0, 70, -600, 0},
                              {-10, -13, -580, 0}, {14, -10, -580, 0}, {0, 12, -580, 0}};
  mesh::Triangles triangles = (mesh::Triangles(3, 2) << 0, 3, 1, 4, 2, 5).finished();
  CameraIntrinsics camera{500, 500, 64, 50, 127, 101};
};

TEST_F(RefineObservation, DepthMapAgreesWithAScalarRasteriser) {
  const TwoTriangles scene;
  const ImagePyramid pyramid(context(), 127, 101);
  FrameParameters parameters{};
  set_frame_parameters(pyramid, scene.camera, scene.positions, parameters);
  const gpu::Buffer uniform = upload_parameters(context(), parameters);
  const LevelState state(context(), 6);
  gpu::upload(context(), state.positions.buffer, std::as_bytes(std::span(scene.positions)));
  const OcclusionMap map(context(), scene.triangles);
  const ObservationKernels kernels(context());
  gpu::run_now(context(), "depth",
               [&](gpu::Batch& batch) { kernels.record_depth(batch, state, map, uniform); });
  const auto found = test::read<std::uint32_t>(context(), map.depth_bits);

  const auto size = static_cast<int>(OcclusionMap::size_px);
  int differing = 0;
  int covered = 0;
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      // The plane z = const under the pixel, inside by the signs of its three edges.
      float expected = std::numeric_limits<float>::infinity();
      for (Eigen::Index t = 0; t < 2; ++t) {
        std::array<Eigen::Vector2f, 3> corner;
        float depth = 0;
        for (Eigen::Index k = 0; k < 3; ++k) {
          const vec4& p = scene.positions[static_cast<std::size_t>(scene.triangles(k, t))];
          depth = -p.z;
          const float u = parameters.projection.x * p.x / depth + parameters.projection.z;
          const float v = parameters.projection.y * -p.y / depth + parameters.projection.w;
          corner[static_cast<std::size_t>(k)] = {u * parameters.depth_from_px.x + parameters.depth_from_px.z,
                                                 v * parameters.depth_from_px.y + parameters.depth_from_px.w};
        }
        bool positive = true;
        bool negative = true;
        for (std::size_t k = 0; k < 3; ++k) {
          const Eigen::Vector2f edge = corner[(k + 1) % 3] - corner[k];
          const Eigen::Vector2f to =
              Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - corner[k];
          const float side = edge.x() * to.y() - edge.y() * to.x();
          positive = positive && side >= 0;
          negative = negative && side <= 0;
        }
        if (positive || negative) {
          expected = std::min(expected, depth);
        }
      }
      const float depth = std::bit_cast<float>(found[static_cast<std::size_t>(y * size + x)]);
      covered += std::isfinite(expected) ? 1 : 0;
      if (std::isfinite(expected) != std::isfinite(depth) ||
          (std::isfinite(depth) && std::abs(depth - expected) > 1e-2F)) {
        ++differing;
      }
    }
  }
  EXPECT_GT(covered, 20000);
  // Pixels whose centre lies on an edge to within rounding may fall to either side.
  EXPECT_LT(differing, 40);
}

TEST_F(RefineObservation, ProlongAgreesWithTheStencils) {
  const test::SmallProblem small = test::make_problem(5, 11, 71, 1);
  const std::vector<mesh::Level>& levels = small.hierarchy->levels;
  ASSERT_EQ(levels.size(), 2U);
  const test::DeviceLevel level(context(), small);
  const LevelStencils stencils(context(), levels[1].from_coarser);
  std::vector<mesh::Vertices> positions;
  mesh::push_positions(*small.hierarchy, small.control_mm, positions);
  std::mt19937 random(73);
  std::normal_distribution<float> normal;
  std::vector<vec4> coarse;
  Eigen::MatrixXf displacements(1, positions[0].cols());
  for (Eigen::Index i = 0; i < positions[0].cols(); ++i) {
    displacements(0, i) = normal(random);
    coarse.push_back({positions[0](0, i), positions[0](1, i), positions[0](2, i), displacements(0, i)});
  }
  const DeviceArray coarser(context(), coarse.size(), gpu::TexelFormat::Rgba32f, "coarser");
  gpu::upload(context(), coarser.buffer, std::as_bytes(std::span(coarse)));
  Eigen::MatrixXf prolonged;
  mesh::apply(levels[1].from_coarser, displacements, prolonged);
  const ObservationKernels kernels(context());

  for (const bool keep : {false, true}) {
    FrameParameters parameters{};
    parameters.keep_displacements = keep ? 1 : 0;
    const gpu::Buffer uniform = upload_parameters(context(), parameters);
    const test::DeviceLevel fresh(context(), small);
    gpu::run_now(context(), "prolong", [&](gpu::Batch& batch) {
      kernels.record_prolong(batch, fresh.topology, stencils, coarser.view, fresh.state, uniform,
                             {true, Prior::Prolonged});
    });
    const auto found = test::read<vec4>(context(), fresh.state.positions.buffer);
    const auto priors = test::read<float>(context(), fresh.state.priors.buffer);
    for (Eigen::Index i = 0; i < positions[1].cols(); ++i) {
      const auto v = static_cast<std::size_t>(i);
      EXPECT_LT((test::head(found[v]) - positions[1].col(i).cast<double>()).norm(), 1e-5);
      const bool fixed = small.problem.fixed[v] != 0;
      const double prior = fixed ? 0 : static_cast<double>(prolonged(0, i));
      const double held = small.start_mm[i] - small.problem.prolonged_mm[i];
      EXPECT_NEAR(static_cast<double>(priors[v]), prior, 1e-6);
      EXPECT_NEAR(static_cast<double>(found[v].w), fixed ? 0 : prior + (keep ? held : 0), 1e-6);
    }
    EXPECT_TRUE(fresh.tails_intact(context()));
  }
}

/// A small problem turned to face the camera, 500 mm away, in an image of a ramp.
struct RampScene {
  RampScene(gpu::Context& context, int saturated_column)
      : small(test::make_problem(5, 11, 79, 1)),
        pyramid(context, 301, 357),
        saturated_from(saturated_column),
        triangles(small.hierarchy->levels[0].triangles) {
    for (Eigen::Index i = 0; i < small.problem.vertex_count(); ++i) {
      small.problem.vertices_mm.col(i) += Eigen::Vector3d(-10, -22, -500);
    }
    for (int y = 0; y < static_cast<int>(pyramid.linear.height_px()); ++y) {
      for (int x = 0; x < static_cast<int>(pyramid.linear.width_px()); ++x) {
        linear.push_back(to_half(0.1F + 0.002F * static_cast<float>(x)));
        linear.push_back(to_half(0.1F + 0.002F * static_cast<float>(y)));
        linear.push_back(to_half(0.25F));
        linear.push_back(to_half(x >= saturated_from ? 0.0F : 1.0F));
      }
    }
  }

  static std::uint16_t to_half(float value) {
    // Positive, normal numbers only.
    if (value == 0) {
      return 0;
    }
    int exponent = 0;
    const float mantissa = std::frexp(value, &exponent);
    return static_cast<std::uint16_t>((exponent + 14) << 10) +
           static_cast<std::uint16_t>(std::lround((mantissa * 2 - 1) * 1024));
  }

  void upload_image(gpu::Context& context) const { upload_image(context, pyramid); }
  void upload_image(gpu::Context& context, const ImagePyramid& onto) const {
    std::vector<std::uint16_t> level = linear;
    for (std::uint32_t mip = 0; mip < onto.linear.level_count(); ++mip) {
      const gpu::Buffer staging(context, onto.linear.level_bytes(mip), gpu::Memory::Upload, "ramp");
      std::ranges::copy(level, staging.mapped_as<std::uint16_t>().begin());
      gpu::run_now(context, "ramp", [&](gpu::Batch& batch) { batch.copy(staging, onto.linear, mip); });
      level = halved(level, onto.linear.width_px(mip));
    }
  }

  /// Means of 2x2 pixels, width of the level that is halved.
  static std::vector<std::uint16_t> halved(const std::vector<std::uint16_t>& level, std::size_t width) {
    std::vector<std::uint16_t> out;
    for (std::size_t y = 0; y + 1 < level.size() / 4 / width; y += 2) {
      for (std::size_t x = 0; x + 1 < width; x += 2) {
        for (std::size_t c = 0; c < 4; ++c) {
          float sum = 0;
          for (const std::size_t i : {std::size_t{0}, std::size_t{1}, width, width + 1}) {
            sum += half_to_float(level[4 * (y * width + x + i) + c]);
          }
          out.push_back(to_half(sum / 4));
        }
      }
    }
    return out;
  }

  test::SmallProblem small;
  ImagePyramid pyramid;
  int saturated_from;  ///< column from which on every pixel is
  mesh::Triangles triangles;
  CameraIntrinsics camera{2000, 2000, 150, 178, 301, 357};
  std::vector<std::uint16_t> linear;
};

TEST_F(RefineObservation, ObserveAgreesWithTheScalarOne) {
  RampScene scene(context(), 160);
  scene.upload_image(context());
  const test::DeviceLevel level(context(), scene.small);
  FrameParameters parameters{};
  const auto positions = test::read<vec4>(context(), level.state.positions.buffer);
  set_frame_parameters(scene.pyramid, scene.camera, std::span(positions).first(level.topology.vertex_count),
                       parameters);
  const gpu::Buffer uniform = upload_parameters(context(), parameters);
  const OcclusionMap map(context(), scene.small.hierarchy->levels[1].triangles);
  const ObservationKernels kernels(context());
  gpu::run_now(context(), "observe", [&](gpu::Batch& batch) {
    kernels.record_depth(batch, level.state, map, uniform);
    kernels.record_observe(batch, level.topology, level.state, scene.pyramid, map, uniform);
  });
  const auto normals = test::read<vec4>(context(), level.state.normals.buffer);
  const auto colours = test::read<vec4>(context(), level.state.colours.buffer);

  const reference::Problem& problem = scene.small.problem;
  const Eigen::Matrix3Xd expected_normals = reference::coarse_normals(*problem.rings, problem.vertices_mm);
  const Eigen::VectorXd expected_spacing = reference::ring_spacing(*problem.rings, problem.vertices_mm);
  int seen = 0;
  int saturated = 0;
  for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
    const auto v = static_cast<std::size_t>(i);
    EXPECT_LT((test::head(normals[v]) - expected_normals.col(i)).norm(),
              2e-4);  // 1e-7 of 500 mm against 2 mm edges
    EXPECT_NEAR(static_cast<double>(normals[v].w), expected_spacing[i], 1e-4);
    if (problem.fixed[v] != 0) {
      EXPECT_EQ(colours[v].w, 0);
      continue;
    }
    const Eigen::Vector3d p = problem.vertices_mm.col(i) + scene.small.start_mm[i] * expected_normals.col(i);
    const double u = 2000 * p.x() / -p.z() + 150;
    const double y = 2000 * -p.y() / -p.z() + 178;
    const double spacing_px = expected_spacing[i] * 2000 / -p.z();
    const double facing = expected_normals.col(i).dot(-p.normalized());
    const double t = std::clamp((facing - 0.15) / 0.3, 0.0, 1.0);
    if (u > scene.saturated_from + 2 * spacing_px) {
      EXPECT_EQ(colours[v].w, 0);
      ++saturated;
    } else if (u < scene.saturated_from - 2 * spacing_px) {
      // Averages of a ramp are the ramp; odd sizes shift a mip by up to half a pixel of the finest level.
      EXPECT_NEAR(static_cast<double>(colours[v].x), 0.1 + 0.002 * u, 3e-3);
      EXPECT_NEAR(static_cast<double>(colours[v].y), 0.1 + 0.002 * y, 3e-3);
      EXPECT_NEAR(static_cast<double>(colours[v].z), 0.25, 1e-3);
      if (colours[v].w > 0) {
        EXPECT_NEAR(static_cast<double>(colours[v].w), t * t * (3 - 2 * t), 1e-3);
        ++seen;
      }
    }
  }
  EXPECT_GT(seen, 100);
  EXPECT_GT(saturated, 20);
  EXPECT_TRUE(level.tails_intact(context()));
}

TEST_F(RefineObservation, ViewsAreMergedAsByTheScalarSums) {
  RampScene scene(context(), 301);
  scene.upload_image(context());
  const test::DeviceLevel level(context(), scene.small);
  const auto positions = test::read<vec4>(context(), level.state.positions.buffer);
  const auto vertices = std::span(positions).first(level.topology.vertex_count);
  FrameParameters parameters{};
  set_frame_parameters(scene.pyramid, scene.camera, vertices, parameters);
  const gpu::Buffer uniform = upload_parameters(context(), parameters);
  const mesh::Triangles& triangles = scene.small.hierarchy->levels[1].triangles;
  const OcclusionMap map(context(), triangles);
  FurtherCameraState view(context(), 301, 357, triangles);
  scene.upload_image(context(), view.pyramid);
  // A camera to the right, turned back towards the face.
  Eigen::Isometry3f view_from_reference = Eigen::Isometry3f::Identity();
  view_from_reference.rotate(Eigen::AngleAxisf(0.3F, Eigen::Vector3f::UnitY()));
  view_from_reference.translation() = Eigen::Vector3f(-150, 3, 20);
  FrameParameters& of_view = view.frame.mapped_as<FrameParameters>().front();
  set_frame_parameters(view.pyramid, scene.camera, vertices, of_view, view_from_reference);
  const DeviceArray view_colours(context(), level.topology.vertex_count + test::kTailCount,
                                 gpu::TexelFormat::Rgba32f, "view colours");
  const ObservationKernels kernels(context());
  std::vector<vec4> alone;
  for (const bool shows_face : {true, false}) {
    of_view.source_px.z = shows_face ? 1 : 0;
    gpu::run_now(context(), "observe", [&](gpu::Batch& batch) {
      kernels.record_depth(batch, level.state, map, uniform);
      kernels.record_observe(batch, level.topology, level.state, scene.pyramid, map, uniform);
    });
    alone = test::read<vec4>(context(), level.state.colours.buffer);
    gpu::run_now(context(), "view", [&](gpu::Batch& batch) {
      kernels.record_depth(batch, level.state, view.depth, view.frame);
      kernels.record_view(batch, level.topology, level.state, view, view_colours, true, true);
    });
    const auto seen = test::read<vec4>(context(), view_colours.buffer);
    const auto merged = test::read<vec4>(context(), level.state.colours.buffer);
    const auto normals = test::read<vec4>(context(), level.state.normals.buffer);
    Eigen::Array3d of_reference = Eigen::Array3d::Zero();
    Eigen::Array3d of_other = Eigen::Array3d::Zero();
    for (std::size_t v = 0; v < vertices.size(); ++v) {
      const double weight = std::min(static_cast<double>(alone[v].w), static_cast<double>(seen[v].w));
      of_reference += weight * test::head(alone[v]).array();
      of_other += weight * test::head(seen[v]).array();
    }
    const Eigen::Array3d gain = of_reference / of_other;  // not used where nothing is seen
    int both = 0;
    for (std::size_t v = 0; v < vertices.size(); ++v) {
      if (seen[v].w == 0) {
        EXPECT_EQ(test::head(merged[v]), test::head(alone[v]));
        EXPECT_EQ(merged[v].w, alone[v].w);
        continue;
      }
      ASSERT_TRUE(shows_face);
      // Where the point lies in the other camera's frame, and what the ramp shows there.
      const Eigen::Vector3d in_shading =
          test::head(positions[v]) + static_cast<double>(positions[v].w) * test::head(normals[v]);
      const Eigen::Vector3d p = view_from_reference.cast<double>() *
                                Eigen::Vector3d(in_shading.x(), -in_shading.y(), -in_shading.z());
      EXPECT_NEAR(static_cast<double>(seen[v].x), 0.1 + 0.002 * (2000 * p.x() / p.z() + 150), 4e-3);
      EXPECT_NEAR(static_cast<double>(seen[v].y), 0.1 + 0.002 * (2000 * p.y() / p.z() + 178), 4e-3);
      const Eigen::Vector3d n = view_from_reference.linear().cast<double>() *
                                Eigen::Vector3d(test::head(normals[v]).x(), -test::head(normals[v]).y(),
                                                -test::head(normals[v]).z());
      const double t = std::clamp((n.dot(-p.normalized()) - 0.15) / 0.3, 0.0, 1.0);
      EXPECT_NEAR(static_cast<double>(seen[v].w), t * t * (3 - 2 * t), 2e-3);
      const double a = static_cast<double>(alone[v].w);
      const double b = static_cast<double>(seen[v].w);
      const Eigen::Array3d mean =
          (a * test::head(alone[v]).array() + b * gain * test::head(seen[v]).array()) / (a + b);
      EXPECT_LT((mean - test::head(merged[v]).array()).abs().maxCoeff(), 1e-4);
      EXPECT_NEAR(static_cast<double>(merged[v].w), std::min(1.0, a + b), 1e-5);
      ++both;
    }
    EXPECT_EQ(both > 100, shows_face) << both;
  }
}

TEST_F(RefineObservation, HiddenVerticesAndOutlinesCarryNoWeight) {
  RampScene scene(context(), 301);
  scene.upload_image(context());
  const test::DeviceLevel level(context(), scene.small);
  const auto positions = test::read<vec4>(context(), level.state.positions.buffer);
  FrameParameters parameters{};
  set_frame_parameters(scene.pyramid, scene.camera, std::span(positions).first(level.topology.vertex_count),
                       parameters);
  const gpu::Buffer uniform = upload_parameters(context(), parameters);
  const OcclusionMap map(context(), scene.small.hierarchy->levels[1].triangles);
  const ObservationKernels kernels(context());
  gpu::run_now(context(), "depth",
               [&](gpu::Batch& batch) { kernels.record_depth(batch, level.state, map, uniform); });
  // Something 60 mm before the face on its left.
  constexpr std::size_t kHiddenColumns = 48;
  auto bits = test::read<std::uint32_t>(context(), map.depth_bits);
  for (std::size_t i = 0; i < bits.size(); ++i) {
    if (i % OcclusionMap::size_px < kHiddenColumns) {
      bits[i] = std::bit_cast<std::uint32_t>(440.0F);
    }
  }
  gpu::upload(context(), map.depth_bits, std::span<const std::uint32_t>(bits));
  gpu::run_now(context(), "observe", [&](gpu::Batch& batch) {
    kernels.record_observe(batch, level.topology, level.state, scene.pyramid, map, uniform);
  });
  const auto colours = test::read<vec4>(context(), level.state.colours.buffer);
  int hidden = 0;
  int shown = 0;
  for (std::size_t v = 0; v < level.topology.vertex_count; ++v) {
    if (scene.small.problem.fixed[v] != 0) {
      continue;
    }
    const vec4& p = positions[v];
    const float u = parameters.projection.x * p.x / -p.z + parameters.projection.z;
    const float x = u * parameters.depth_from_px.x + parameters.depth_from_px.z;
    constexpr float kClear = 14;  // beyond the reach of the outline test
    if (x < kHiddenColumns - kClear) {
      EXPECT_EQ(colours[v].w, 0);
      ++hidden;
    } else if (x > kHiddenColumns + kClear) {
      shown += colours[v].w > 0 ? 1 : 0;
    }
  }
  EXPECT_GT(hidden, 10);
  EXPECT_GT(shown, 30);
}

}  // namespace
}  // namespace facet::refine
