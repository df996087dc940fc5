#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "device_level.hpp"
#include "refine/albedo.hpp"
#include "refine/displacement_kernels.hpp"
#include "refine/lighting.hpp"
#include "refine/observation.hpp"
#include "support/gpu.hpp"

namespace facet::refine {
namespace {

using shaders::vec4;
using shaders::refine::FrameParameters;
using shaders::refine::Light;

using RefineLighting = facet::test::GpuTest;
using RefineAlbedo = facet::test::GpuTest;

gpu::Buffer frame_with(gpu::Context& context, bool keep_lighting) {
  gpu::Buffer out(context, sizeof(FrameParameters), gpu::Memory::Upload, "frame parameters");
  FrameParameters& frame = out.mapped_as<FrameParameters>()[0];
  frame = {};
  frame.keep_lighting = keep_lighting ? 1 : 0;
  frame.learn_albedo = 1;
  return out;
}

reference::Lighting to_reference(const Light& light) {
  const std::array<float, 9> values = unpack_light(light);
  return Eigen::Map<const Eigen::Matrix<float, 9, 1>>(values.data()).cast<double>();
}

std::array<float, 9> to_array(const reference::Lighting& light) {
  std::array<float, 9> out{};
  for (int k = 0; k < 9; ++k) {
    out[static_cast<std::size_t>(k)] = static_cast<float>(light[k]);
  }
  return out;
}

/// Sum of weight |rho|^2: the unit of the temporal weight.
double weight_unit(const reference::Problem& problem) {
  double sum = 0;
  for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
    sum += problem.data_weight[i] * problem.albedo.col(i).squaredNorm();
  }
  return sum;
}

/// What the room's lamps give every vertex.
Eigen::VectorXd lamps_of(const reference::Problem& problem, const Eigen::Matrix3Xd& normals) {
  Eigen::VectorXd out(problem.vertex_count());
  for (Eigen::Index i = 0; i < out.size(); ++i) {
    out[i] = reference::lit_by_lamps(problem.irradiance.col(i), normals.col(i));
  }
  return out;
}

TEST_F(RefineLighting, AgreesWithTheReference) {
  for (const auto& [columns, rows] : {std::pair{2, 2}, std::pair{5, 11}, std::pair{12, 13}}) {
    SCOPED_TRACE(columns);
    const test::SmallProblem small = test::make_problem(columns, rows, 83);
    const reference::Problem& problem = small.problem;
    const test::DeviceLevel level(context(), small);
    const LightingState lighting(context());
    reference::RoomLighting previous;
    previous << 0.5, 0.1, 0.2, 0.3, 0, 0.02, 0.01, 0, 0.05, 0.8;
    Light packed = pack_light(to_array(previous.head<9>()), 1);
    packed.room.x = 0.8F;
    gpu::upload(context(), lighting.light, std::as_bytes(std::span(&packed, 1)));
    const LightingKernels kernels(context());
    constexpr float kTemporal = 0.07F;
    const gpu::Buffer frame = frame_with(context(), true);
    gpu::run_now(context(), "lighting", [&](gpu::Batch& batch) {
      kernels.record(batch, level.topology, level.state, lighting, frame, {kTemporal, 0});
    });
    const Light found = test::read<Light>(context(), lighting.light).front();
    const Eigen::Matrix3Xd normals = reference::displaced_normals(problem, small.start_mm);
    const reference::RoomLighting expected = reference::estimate_lighting(
        normals, lamps_of(problem, normals), problem.albedo, problem.colours, problem.data_weight,
        static_cast<double>(kTemporal) * weight_unit(problem), previous);
    // Normal equations in single precision: 1e-7 times their condition, which the prior holds below 1e3.
    EXPECT_LT((to_reference(found) - expected.head<9>()).norm(), 2e-4 * expected.norm());
    EXPECT_NEAR(static_cast<double>(found.room.x), expected[9], 2e-4 * expected.norm());
    double weights = 0;
    double squares = 0;
    for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
      weights += problem.data_weight[i];
      squares += problem.data_weight[i] * problem.colours.col(i).squaredNorm();
    }
    EXPECT_NEAR(static_cast<double>(found.gain), 3 * weights / squares, 1e-4 * 3 * weights / squares);
    EXPECT_TRUE(level.tails_intact(context()));
  }
}

TEST_F(RefineLighting, OutliersLoseTheirWeight) {
  test::SmallProblem small = test::make_problem(12, 13, 89);
  reference::Problem& problem = small.problem;
  const Eigen::Matrix3Xd normals = reference::displaced_normals(problem, small.start_mm);
  for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
    problem.colours.col(i) = reference::reflected(problem, normals.col(i), i);
    if (i % 11 == 0) {
      problem.colours.col(i).setConstant(0.95);
    }
  }
  const test::DeviceLevel level(context(), small);
  const LightingKernels kernels(context());
  const gpu::Buffer frame = frame_with(context(), false);
  std::array<double, 2> errors{};
  for (const bool robust : {false, true}) {
    const LightingState lighting(context());
    gpu::run_now(context(), "lighting", [&](gpu::Batch& batch) {
      kernels.record(batch, level.topology, level.state, lighting, frame, {0, robust ? 0.6F : 0.0F});
    });
    const reference::Lighting found = to_reference(test::read<Light>(context(), lighting.light).front());
    double worst = 0;
    for (Eigen::Index i = 0; i < problem.vertex_count(); ++i) {
      worst = std::max(worst, std::abs((found - problem.lighting).dot(reference::sh_basis(normals.col(i)))));
    }
    errors[robust ? 1 : 0] = worst;
  }
  EXPECT_LT(errors[1], 0.3 * errors[0]);
}

TEST_F(RefineLighting, WithoutAnyVisibleVertexThePreviousLightStays) {
  test::SmallProblem small = test::make_problem(4, 4, 97);
  small.problem.data_weight.setZero();
  const test::DeviceLevel level(context(), small);
  const LightingState lighting(context());
  const Light before = pack_light({1, 2, 3, 4, 5, 6, 7, 8, 9}, 3);
  gpu::upload(context(), lighting.light, std::as_bytes(std::span(&before, 1)));
  const LightingKernels kernels(context());
  const gpu::Buffer frame = frame_with(context(), true);
  gpu::run_now(context(), "lighting", [&](gpu::Batch& batch) {
    kernels.record(batch, level.topology, level.state, lighting, frame, {0.1F, 0.5F});
  });
  EXPECT_EQ(unpack_light(test::read<Light>(context(), lighting.light).front()), unpack_light(before));
}

TEST_F(RefineAlbedo, AgreesWithTheReferenceOverTwoFrames) {
  for (const auto& [columns, rows] : {std::pair{2, 2}, std::pair{5, 11}}) {
    SCOPED_TRACE(columns);
    const test::SmallProblem small = test::make_problem(columns, rows, 101);
    const reference::Problem& problem = small.problem;
    const Eigen::Index count = problem.vertex_count();
    const test::DeviceLevel level(context(), small);
    AlbedoOptions options;
    options.smooth_weight = 0.8F;
    options.pcg_iterations = 60;
    options.frame_quota = 10;
    const AlbedoState albedo(context(), level.topology.vertex_count, options.pcg_iterations);
    Eigen::Matrix3Xd mean(3, count);
    std::vector<vec4> mean_packed;
    for (Eigen::Index i = 0; i < count; ++i) {
      mean.col(i) << 0.5 + 0.001 * static_cast<double>(i), 0.4, 0.3;
      mean_packed.push_back(test::join(mean.col(i), 0));
    }
    gpu::upload(context(), albedo.mean.buffer, std::as_bytes(std::span(mean_packed)));
    const LightingState lighting(context());
    constexpr double kGain = 3.5;
    const Light light = pack_light(to_array(problem.lighting), static_cast<float>(kGain));
    const AlbedoKernels kernels(context());
    const gpu::Buffer frame = frame_with(context(), false);
    gpu::Batch batch(context(), "albedo");
    kernels.record(batch, level.topology, level.state, albedo, frame, lighting.light, options);
    batch.finish();
    for (int k = 0; k < 2; ++k) {
      gpu::upload(context(), lighting.light, std::as_bytes(std::span(&light, 1)));
      ASSERT_EQ(batch.submit(), gpu::Outcome::Done);
      ASSERT_EQ(batch.wait(), gpu::Outcome::Done);
    }

    const Eigen::Matrix3Xd normals = reference::displaced_normals(problem, small.start_mm);
    Eigen::VectorXd shade_squared(count);
    Eigen::Matrix3Xd shade_colour(3, count);
    double unit = 0;
    double seen = 0;
    for (Eigen::Index i = 0; i < count; ++i) {
      const double shade = problem.lighting.dot(reference::sh_basis(normals.col(i))) +
                           reference::lit_by_lamps(problem.irradiance.col(i), normals.col(i));
      const double weight = 2 * kGain * problem.data_weight[i];
      shade_squared[i] = weight * shade * shade;
      shade_colour.col(i) = weight * shade * problem.colours.col(i);
      unit += shade_squared[i];
      seen += shade_squared[i] > 0 ? 1 : 0;
    }
    unit /= seen;
    // The mean albedo tinted to what was seen is the prior.
    Eigen::Vector3d seen_sum = Eigen::Vector3d::Zero();
    Eigen::Vector3d mean_sum = Eigen::Vector3d::Zero();
    for (Eigen::Index i = 0; i < count; ++i) {
      seen_sum += shade_colour.col(i).cwiseProduct(mean.col(i));
      mean_sum += shade_squared[i] * mean.col(i).cwiseAbs2();
    }
    const Eigen::Matrix3Xd prior = seen_sum.cwiseQuotient(mean_sum).asDiagonal() * mean;
    constexpr double kMeanPrior = 1e-3;  // as in albedo_gradient.comp
    const Eigen::Matrix3Xd solved =
        reference::estimate_albedo(*problem.rings, (shade_squared / unit).array() + kMeanPrior,
                                   shade_colour / unit + kMeanPrior * prior, prior, 0.8);
    const Eigen::RowVector3d luminance(0.2126, 0.7152, 0.0722);
    double bright = 0;
    double wanted = 0;
    for (Eigen::Index i = 0; i < count; ++i) {
      if (problem.data_weight[i] > 0) {
        bright += luminance * solved.col(i);
        wanted += luminance * mean.col(i);
      }
    }
    const double scale = wanted / bright;
    const auto found = test::read<vec4>(context(), level.state.albedo.buffer);
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto v = static_cast<std::size_t>(i);
      // 120 PCG iterations in single precision.
      EXPECT_LT((test::head(found[v]) - scale * solved.col(i)).norm(), 2e-4) << i;
      EXPECT_NEAR(static_cast<double>(found[v].w), std::min(1.0, 2 * problem.data_weight[i] / 10), 1e-5);
    }
    const Light scaled = test::read<Light>(context(), lighting.light).front();
    EXPECT_LT((to_reference(scaled) * scale - problem.lighting).norm(), 1e-4);
    EXPECT_NEAR(static_cast<double>(scaled.room.x) * scale, 1, 1e-4);
    EXPECT_NEAR(static_cast<double>(albedo.gained_in_frame(level.topology.workgroup_count)),
                problem.data_weight.sum(), 1e-3);
    EXPECT_TRUE(level.tails_intact(context()));
  }
}

TEST_F(RefineAlbedo, VerticesStopLearningAtTheirQuota) {
  const test::SmallProblem small = test::make_problem(5, 5, 103);
  const test::DeviceLevel level(context(), small);
  AlbedoOptions options;
  options.smooth_weight = 1;
  options.frame_quota = 3;
  const AlbedoState albedo(context(), level.topology.vertex_count, options.pcg_iterations);
  const LightingState lighting(context());
  const Light light = pack_light(to_array(small.problem.lighting), 1);
  gpu::upload(context(), lighting.light, std::as_bytes(std::span(&light, 1)));
  const AlbedoKernels kernels(context());
  const gpu::Buffer frame = frame_with(context(), false);
  gpu::Batch batch(context(), "albedo");
  kernels.record(batch, level.topology, level.state, albedo, frame, lighting.light, options);
  batch.finish();
  float gained = 1;
  for (int k = 0; k < 30; ++k) {
    ASSERT_EQ(batch.submit(), gpu::Outcome::Done);
    ASSERT_EQ(batch.wait(), gpu::Outcome::Done);
    gained = albedo.gained_in_frame(level.topology.workgroup_count);
  }
  EXPECT_EQ(gained, 0);
}

TEST_F(RefineAlbedo, ProlongsThroughTheStencils) {
  const test::SmallProblem small = test::make_problem(5, 11, 107, 1);
  const std::vector<mesh::Level>& levels = small.hierarchy->levels;
  ASSERT_EQ(levels.size(), 2U);
  const test::DeviceLevel level(context(), small);
  const LevelStencils stencils(context(), levels[1].from_coarser);
  const LevelState coarser(context(), static_cast<std::uint32_t>(levels[0].vertex_count));
  std::mt19937 random(109);
  std::uniform_real_distribution<float> uniform;
  Eigen::MatrixXf coarse(4, levels[0].vertex_count);
  std::vector<vec4> packed;
  for (Eigen::Index i = 0; i < coarse.cols(); ++i) {
    coarse.col(i) << uniform(random), uniform(random), uniform(random), uniform(random);
    packed.push_back({coarse(0, i), coarse(1, i), coarse(2, i), coarse(3, i)});
  }
  gpu::upload(context(), coarser.albedo.buffer, std::as_bytes(std::span(packed)));
  const ObservationKernels kernels(context());
  gpu::run_now(context(), "prolong albedo", [&](gpu::Batch& batch) {
    kernels.record_prolong_values(batch, level.topology, stencils, coarser.albedo, level.state.albedo);
  });
  Eigen::MatrixXf expected;
  mesh::apply(levels[1].from_coarser, coarse, expected);
  const auto found = test::read<vec4>(context(), level.state.albedo.buffer);
  for (Eigen::Index i = 0; i < expected.cols(); ++i) {
    const vec4& value = found[static_cast<std::size_t>(i)];
    EXPECT_LT((Eigen::Vector4f(value.x, value.y, value.z, value.w) - expected.col(i)).norm(), 1e-6F);
  }
  EXPECT_TRUE(level.tails_intact(context()));
}

TEST_F(RefineLighting, DisplacementKernelsStayWithinTheirArrays) {
  for (const auto& [columns, rows] : {std::pair{2, 2}, std::pair{5, 11}}) {
    const test::SmallProblem small = test::make_problem(columns, rows, 113);
    const test::DeviceLevel level(context(), small);
    const std::uint32_t count = level.topology.vertex_count;
    const std::uint32_t places = level.topology.patches.place_count;
    const SolverScratch scratch(context(), count + test::kTailCount,
                                level.topology.group_count + test::kTailCount, places + test::kTailCount, 3);
    test::write(context(), scratch.slopes.buffer, std::vector<vec4>(count));
    test::write(context(), scratch.bends.buffer, std::vector<shaders::vec2>(count));
    test::write(context(), scratch.solver_starts.buffer, std::vector<vec4>(count));
    test::write(context(), scratch.preconditioned.buffer, std::vector<float>(places));
    test::write(context(), scratch.products.buffer, std::vector<shaders::vec2>(places));
    test::write(context(), scratch.states.buffer, std::vector<vec4>(places));
    test::write(context(), scratch.jacobian_rows.buffer,
                std::vector<shaders::uvec2>(level.topology.group_count));
    test::write(context(), scratch.jacobian_columns.buffer,
                std::vector<shaders::uvec2>(level.topology.group_count));
    const LightingState lighting(context());
    const Light light = pack_light(to_array(small.problem.lighting), 1);
    gpu::upload(context(), lighting.light, std::as_bytes(std::span(&light, 1)));
    DisplacementOptions options;
    options.smooth_weight = 0.02F;
    const DisplacementKernels kernels(context());
    gpu::run_now(context(), "solve", [&](gpu::Batch& batch) {
      kernels.record(batch, level.topology, level.state, scratch, lighting.light, options, 0);
    });
    EXPECT_TRUE(level.tails_intact(context()));
    EXPECT_TRUE(test::tail_intact<vec4>(context(), scratch.slopes.buffer, count));
    EXPECT_TRUE(test::tail_intact<shaders::vec2>(context(), scratch.bends.buffer, count));
    EXPECT_TRUE(test::tail_intact<vec4>(context(), scratch.solver_starts.buffer, count));
    EXPECT_TRUE(test::tail_intact<float>(context(), scratch.preconditioned.buffer, places));
    EXPECT_TRUE(test::tail_intact<shaders::vec2>(context(), scratch.products.buffer, places));
    EXPECT_TRUE(test::tail_intact<vec4>(context(), scratch.states.buffer, places));
    EXPECT_TRUE(test::tail_intact<shaders::uvec2>(context(), scratch.jacobian_rows.buffer,
                                                  level.topology.group_count));
    EXPECT_TRUE(test::tail_intact<shaders::uvec2>(context(), scratch.jacobian_columns.buffer,
                                                  level.topology.group_count));
    // Place 0 stays 0, or padded rings would gather garbage.
    EXPECT_EQ(test::read<float>(context(), scratch.preconditioned.buffer).front(), 0);
    EXPECT_EQ(test::read<shaders::vec2>(context(), scratch.products.buffer).front().x, 0);
  }
}

}  // namespace
}  // namespace facet::refine
