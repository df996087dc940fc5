#include "stereo/spacetime_solver.hpp"

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "facet/error.hpp"
#include "reference.hpp"
#include "support/gpu.hpp"

namespace facet::stereo {
namespace {

using SpacetimeSolverTest = facet::test::GpuTest;
using reference::Volume;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// Random smooth texture seen through a slanted, moving disparity field with other gain and bias on the
/// right; start values that are off by up to `error_px`, and some holes, blank samples and a step.
/// bend_px  height of waves of 24 px along the rows, which windows of 9 px smooth
Volume make_volume(const VolumeSize& size, std::uint32_t seed, double error_px, bool with_holes,
                   double bend_px = 0) {
  Volume out;
  out.size = size;
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int t = 0; t < size.slots; ++t) {
    // One texture a slot, a sum of waves that the right picture shows at x and the left one at x + d.
    std::vector<std::array<double, 4>> waves;
    for (int k = 0; k < 6; ++k) {
      waves.push_back({0.4 + 0.22 * k, 0.25 * uniform(random), std::numbers::pi * uniform(random),
                       0.05 + 0.02 * uniform(random)});
    }
    const auto texture = [&](double x, double y) {
      double sum = 0.45;
      for (const auto& [along, across, phase, height] : waves) {
        sum += height * std::sin(along * x + across * y + phase);
      }
      return sum;
    };
    for (int y = 0; y < size.height_px; ++y) {
      for (int x = 0; x < size.width_px; ++x) {
        const double d =
            1.3 + 0.04 * x - 0.03 * y + 0.2 * t + bend_px * std::sin(2 * std::numbers::pi * x / 24);
        const bool blank = with_holes && t == 1;
        out.left.push_back(blank ? -1 : static_cast<float>(texture(x - d, y)));
        out.right.push_back(blank ? -1 : static_cast<float>(0.8 * texture(x, y) + 0.05));
        const bool hole = with_holes && (uniform(random) > 0.95 || (x < 3 && y < 3));
        const double jump = with_holes && x > size.width_px * 2 / 3 ? 2.5 : 0;
        out.start_px.push_back(hole ? kNan : static_cast<float>(d + jump + error_px * uniform(random)));
      }
    }
  }
  return out;
}

Eigen::VectorXd field_of(const std::vector<float>& px) {
  Eigen::VectorXd out(static_cast<Eigen::Index>(px.size()));
  for (std::size_t i = 0; i < px.size(); ++i) {
    out[static_cast<Eigen::Index>(i)] = std::isnan(px[i]) ? 0 : static_cast<double>(px[i]);
  }
  return out;
}

DisparityField solve(gpu::Context& context, const Volume& volume, const SpacetimeOptions& options) {
  SpacetimeSolver solver(context, volume.size, options);
  gpu::upload(context, solver.left(), std::span<const float>(volume.left));
  gpu::upload(context, solver.right(), std::span<const float>(volume.right));
  DisparityField out;
  solver.solve(volume.start_px, out);
  return out;
}

TEST_F(SpacetimeSolverTest, OneStepAgreesWithTheReference) {
  struct Case {
    VolumeSize size;
    int window_x, window_y, window_t;
    bool holes;
  };
  for (const Case& chosen : {Case{{23, 13, 3}, 9, 5, 5, false}, Case{{23, 13, 3}, 9, 5, 5, true},
                             Case{{17, 11, 4}, 5, 3, 3, true}, Case{{29, 7, 1}, 7, 5, 1, true}}) {
    SCOPED_TRACE(chosen.size.width_px);
    const Volume volume = make_volume(chosen.size, 71, 0.3, chosen.holes);
    SpacetimeOptions options;
    options.window_x = chosen.window_x;
    options.window_y = chosen.window_y;
    options.window_t = chosen.window_t;
    options.steps = 1;
    options.cg_iterations = 150;  // to the end
    options.most_move_px = 100;
    const DisparityField found = solve(context(), volume, options);
    ASSERT_EQ(found.outcome, StereoOutcome::Done) << found.failure;
    const Eigen::VectorXd start = field_of(volume.start_px);
    const Eigen::VectorXd expected = reference::step(volume, start, options);
    const Eigen::VectorXd moved = field_of(found.disparity_px) - start;
    ASSERT_GT(expected.norm(), 1);
    // Differences of window sums in single precision: 1e-6 of sums a hundred times the variances.
    EXPECT_LT((moved - expected).norm(), 2e-3 * expected.norm());
    const double energy = reference::energy(volume, start, options);
    EXPECT_NEAR(found.energies[0], energy, 1e-3 * energy);
    for (std::size_t i = 0; i < volume.start_px.size(); ++i) {
      if (std::isnan(volume.start_px[i])) {
        EXPECT_EQ(found.disparity_px[i], 0);
        EXPECT_EQ(found.sigma_px[i], 0);
      }
    }
  }
}

// Windows are summed in the boxes around the unknowns alone; what a larger box left in the arrays must not
// count.
TEST_F(SpacetimeSolverTest, WhereFewAreUnknownTheStepAgreesWithTheReference) {
  const Volume full = make_volume({37, 23, 4}, 103, 0.3, false);
  Volume few = full;
  for (int t = 0; t < full.size.slots; ++t) {
    for (int y = 0; y < full.size.height_px; ++y) {
      for (int x = 0; x < full.size.width_px; ++x) {
        const bool known = std::hypot(x - 21.0, y - 14.0) < 5.5 + 0.5 * t && t != 3;
        few.start_px[full.size.voxel(x, y, t)] = known ? full.start_px[full.size.voxel(x, y, t)] : kNan;
      }
    }
  }
  SpacetimeOptions options;
  options.steps = 1;
  options.cg_iterations = 150;
  options.most_move_px = 100;
  const Eigen::VectorXd start = field_of(few.start_px);
  const Eigen::VectorXd expected = reference::step(few, start, options);
  const Eigen::VectorXd moved = field_of(solve(context(), few, options).disparity_px) - start;
  ASSERT_GT(expected.norm(), 1);
  EXPECT_LT((moved - expected).norm(), 2e-3 * expected.norm());
  options = {};
  SpacetimeSolver solver(context(), few.size, options);
  gpu::upload(context(), solver.left(), std::span<const float>(few.left));
  gpu::upload(context(), solver.right(), std::span<const float>(few.right));
  std::array<DisparityField, 3> found;
  solver.solve(few.start_px, found[0]);
  solver.solve(full.start_px, found[1]);
  solver.solve(few.start_px, found[2]);
  EXPECT_EQ(found[0].disparity_px, found[2].disparity_px);
  EXPECT_EQ(found[0].sigma_px, found[2].sigma_px);
  EXPECT_EQ(found[0].correlation, found[2].correlation);
  EXPECT_EQ(found[0].energies, found[2].energies);
  for (std::size_t i = 0; i < few.start_px.size(); ++i) {
    EXPECT_TRUE(!std::isnan(few.start_px[i]) || found[2].sigma_px[i] == 0) << i;
  }
  const std::vector<float> none(few.size.voxels(), kNan);
  solver.solve(none, found[0]);
  EXPECT_EQ(found[0].outcome, StereoOutcome::Done);
  EXPECT_EQ(found[0].energies, std::vector<double>(static_cast<std::size_t>(options.steps), 0.0));
}

TEST_F(SpacetimeSolverTest, LocalStepAgreesWithTheReference) {
  const Volume volume = make_volume({19, 11, 3}, 73, 0.3, true);
  SpacetimeOptions options;
  options.method = SpacetimeMethod::Local;
  options.steps = 1;
  options.most_move_px = 100;
  const DisparityField found = solve(context(), volume, options);
  const Eigen::VectorXd start = field_of(volume.start_px);
  double worst = 0;
  int compared = 0;
  for (int t = 0; t < 3; ++t) {
    for (int y = 0; y < 11; ++y) {
      for (int x = 0; x < 19; ++x) {
        const reference::Window window = reference::window_at(volume, start, options, x, y, t);
        if (window.speaks) {
          const Eigen::Matrix4d damped =
              window.hessian + static_cast<double>(options.damping) * Eigen::Matrix4d::Identity();
          const double expected = -(damped.inverse() * window.gradient)[0];
          const std::size_t voxel = volume.size.voxel(x, y, t);
          worst = std::max(worst, std::abs(static_cast<double>(found.disparity_px[voxel]) -
                                           start[static_cast<Eigen::Index>(voxel)] - expected));
          ++compared;
        }
      }
    }
  }
  EXPECT_GT(compared, 300);
  EXPECT_LT(worst, 5e-3);
}

TEST_F(SpacetimeSolverTest, PartsFindTheSameAsOne) {
  const Volume volume = make_volume({37, 140, 3}, 79, 0.3, true);
  const DisparityField whole = solve(context(), volume, {});
  SpacetimeOptions options;
  options.part_bytes = 1;  // a band a part
  const DisparityField parts = solve(context(), volume, options);
  ASSERT_EQ(whole.outcome, StereoOutcome::Done);
  EXPECT_EQ(whole.disparity_px, parts.disparity_px);
  EXPECT_EQ(whole.sigma_px, parts.sigma_px);
  EXPECT_EQ(whole.correlation, parts.correlation);
  EXPECT_EQ(whole.energies, parts.energies);
}

TEST_F(SpacetimeSolverTest, FindsTheFieldBelowAHundredthOfAPixel) {
  const Volume volume = make_volume({61, 31, 5}, 83, 0.4, false);
  SpacetimeOptions options;
  options.steps = 8;
  const DisparityField found = solve(context(), volume, options);
  double square = 0;
  int count = 0;
  for (int t = 0; t < 5; ++t) {
    for (int y = 0; y < 31; ++y) {
      for (int x = 8; x < 53; ++x) {
        const double error = static_cast<double>(found.disparity_px[volume.size.voxel(x, y, t)]) -
                             (1.3 + 0.04 * x - 0.03 * y + 0.2 * t);
        square += error * error;
        ++count;
      }
    }
  }
  EXPECT_LT(std::sqrt(square / count), 0.01);
}

// Without noise the whole error of a bent field is what the windows smooth away, and sigma has to know it.
TEST_F(SpacetimeSolverTest, SigmaKnowsWhatTheWindowsSmoothAway) {
  constexpr double kBend_px = 0.4;
  SpacetimeOptions options;
  options.steps = 8;
  const DisparityField flat = solve(context(), make_volume({97, 31, 5}, 83, 0.4, false), options);
  const Volume volume = make_volume({97, 31, 5}, 83, 0.4, false, kBend_px);
  const DisparityField bent = solve(context(), volume, options);
  double error_square = 0;
  double sigma_square = 0;
  double flat_square = 0;
  for (int y = 4; y < 27; ++y) {
    for (int x = 12; x < 85; ++x) {
      const std::size_t voxel = volume.size.voxel(x, y, 2);
      const double error = static_cast<double>(bent.disparity_px[voxel]) -
                           (1.7 + 0.04 * x - 0.03 * y + kBend_px * std::sin(2 * std::numbers::pi * x / 24));
      error_square += error * error;
      sigma_square += static_cast<double>(bent.sigma_px[voxel] * bent.sigma_px[voxel]);
      flat_square += static_cast<double>(flat.sigma_px[voxel] * flat.sigma_px[voxel]);
    }
  }
  const double ratio = std::sqrt(error_square / sigma_square);
  EXPECT_GT(ratio, 0.4);
  EXPECT_LT(ratio, 1.6);
  EXPECT_GT(sigma_square, 9 * flat_square);
}

TEST_F(SpacetimeSolverTest, WherePicturesSayNothingTheStartStaysAndIsNotTrusted) {
  Volume volume = make_volume({31, 15, 3}, 89, 0.3, false);
  for (int t = 0; t < 3; ++t) {
    for (int y = 0; y < 15; ++y) {
      for (int x = 12; x < 31; ++x) {
        volume.left[volume.size.voxel(x, y, t)] = 0.5F;
      }
    }
  }
  const DisparityField found = solve(context(), volume, {});
  for (int y = 0; y < 15; ++y) {
    const std::size_t voxel = volume.size.voxel(24, y, 1);
    EXPECT_EQ(found.disparity_px[voxel], volume.start_px[voxel]);
    EXPECT_EQ(found.sigma_px[voxel], 0);
    EXPECT_EQ(found.correlation[voxel], 0);
  }
  EXPECT_GT(found.correlation[volume.size.voxel(6, 7, 1)], 0.95F);
}

TEST_F(SpacetimeSolverTest, SaysWhenTheNumbersAreGone) {
  Volume volume = make_volume({31, 15, 3}, 97, 0.3, false);
  volume.start_px[volume.size.voxel(15, 7, 1)] = std::numeric_limits<float>::infinity();
  const DisparityField found = solve(context(), volume, {});
  EXPECT_EQ(found.outcome, StereoOutcome::NumericalFailure);
  EXPECT_FALSE(found.failure.empty());
}

TEST_F(SpacetimeSolverTest, PicturesWithoutNumbersAreNothing) {
  Volume volume = make_volume({31, 15, 3}, 101, 0.3, false);
  volume.left[volume.size.voxel(15, 7, 1)] = std::numeric_limits<float>::infinity();
  volume.right[volume.size.voxel(11, 9, 2)] = kNan;
  EXPECT_EQ(solve(context(), volume, {}).outcome, StereoOutcome::Done);
}

TEST_F(SpacetimeSolverTest, RefusesWhatMakesNoSense) {
  SpacetimeOptions options;
  options.window_x = 4;
  EXPECT_THROW(SpacetimeSolver(context(), {20, 20, 2}, options), Error);
  options = {};
  options.steps = 0;
  EXPECT_THROW(SpacetimeSolver(context(), {20, 20, 2}, options), Error);
  EXPECT_THROW(SpacetimeSolver(context(), {20, 0, 2}, {}), Error);
  SpacetimeSolver solver(context(), {20, 20, 2}, {});
  DisparityField field;
  EXPECT_THROW(solver.solve(std::vector<float>(3), field), Error);
}

}  // namespace
}  // namespace facet::stereo
