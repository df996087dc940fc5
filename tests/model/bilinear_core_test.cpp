#include "model/bilinear_core.hpp"

#include <gtest/gtest.h>

#include <numeric>
#include <random>

namespace facet::model {
namespace {

constexpr unsigned kSeed = 2005;
constexpr int kVertices = 10;  // 0-4 left of the mid-plane, 5-9 their mirror images
constexpr int kModes = 4;      // neutral, a left and a right expression, a symmetric one

Mirror small_mirror() {
  Mirror mirror;
  for (int v = 0; v < kVertices; ++v) {
    mirror.vertex.push_back((v + 5) % 10);
  }
  mirror.expression = {0, 2, 1, 3};
  return mirror;
}

TensorWeights unit_weights() {
  return {Eigen::VectorXd::Ones(kVertices), std::vector<double>(kModes, 1.0)};
}

TensorSlice random_slice(std::mt19937& random) {
  std::normal_distribution<float> normal;
  TensorSlice slice;
  for (int mode = 0; mode < kModes; ++mode) {
    Eigen::Matrix3Xf& row = slice.emplace_back(3, kVertices);
    for (float& value : row.reshaped()) {
      value = normal(random);
    }
  }
  return slice;
}

TensorSlice mirrored(const TensorSlice& slice, const Mirror& mirror) {
  TensorSlice result = slice;
  for (std::size_t mode = 0; mode < slice.size(); ++mode) {
    for (int v = 0; v < kVertices; ++v) {
      const auto& twin = slice[static_cast<std::size_t>(mirror.expression[mode])];
      result[mode].col(v) =
          twin.col(mirror.vertex[static_cast<std::size_t>(v)]).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
    }
  }
  return result;
}

double inner(const TensorSlice& a, const TensorSlice& b) {
  double sum = 0;
  for (std::size_t mode = 0; mode < a.size(); ++mode) {
    sum += static_cast<double>(a[mode].cwiseProduct(b[mode]).sum());
  }
  return sum;
}

/// Slices that a mean and `rank` directions span exactly.
std::vector<TensorSlice> low_rank_slices(std::mt19937& random, int count, int rank) {
  std::vector<TensorSlice> directions;
  for (int r = 0; r <= rank; ++r) {
    directions.push_back(random_slice(random));
  }
  std::normal_distribution<float> normal;
  std::vector<TensorSlice> slices;
  for (int s = 0; s < count; ++s) {
    TensorSlice& slice = slices.emplace_back(directions[0]);
    for (int r = 1; r <= rank; ++r) {
      const float weight = normal(random) * static_cast<float>(rank + 1 - r);
      for (std::size_t mode = 0; mode < slice.size(); ++mode) {
        slice[mode] += weight * directions[static_cast<std::size_t>(r)][mode];
      }
    }
  }
  return slices;
}

TEST(BilinearCore, MeanIsSymmetricAndEveryModeIsSymmetricOrAntisymmetric) {
  std::mt19937 random(kSeed);
  const Mirror mirror = small_mirror();
  const BilinearCore core =
      truncate_identity_mode(low_rank_slices(random, 30, 3), mirror, unit_weights(), {1.0 - 1e-6, 20}, [] {});
  for (int i = 0; i < core.identity_modes; ++i) {
    const TensorSlice& row = core.rows[static_cast<std::size_t>(i)];
    const double parity = inner(row, mirrored(row, mirror)) / inner(row, row);
    EXPECT_NEAR(i == 0 ? parity : std::abs(parity), 1.0, 1e-4) << i;
  }
}

TEST(BilinearCore, ModesAreOrthogonalAndFallInSize) {
  std::mt19937 random(kSeed);
  const BilinearCore core = truncate_identity_mode(low_rank_slices(random, 30, 4), small_mirror(),
                                                   unit_weights(), {1.0 - 1e-6, 20}, [] {});
  for (std::size_t i = 1; i < core.rows.size(); ++i) {
    for (std::size_t j = 1; j < i; ++j) {
      EXPECT_NEAR(inner(core.rows[i], core.rows[j]), 0, 1e-3 * inner(core.rows[1], core.rows[1]));
    }
    if (i > 1) {
      EXPECT_LE(inner(core.rows[i], core.rows[i]), inner(core.rows[i - 1], core.rows[i - 1]) * 1.0001);
    }
  }
}

TEST(BilinearCore, KeepsAllOfALowRankTensor) {
  std::mt19937 random(kSeed);
  constexpr int kRank = 3;
  const auto slices = low_rank_slices(random, 25, kRank);
  const BilinearCore core =
      truncate_identity_mode(slices, small_mirror(), unit_weights(), {1.0 - 1e-6, 40}, [] {});
  // Each direction has a symmetric and an antisymmetric part; the directions' mean adds one antisymmetric
  // part.
  EXPECT_LE(core.identity_modes, 1 + 2 * kRank + 1);
  EXPECT_NEAR(core.explained, 1.0, 1e-6);
  std::vector<int> all(kVertices);
  std::iota(all.begin(), all.end(), 0);
  for (const TensorSlice& slice : slices) {
    const auto error_mm = approximation_error_mm(core, slice, unit_weights(), all);
    EXPECT_LT(error_mm[0], 1e-3);
    EXPECT_LT(error_mm[1], 2e-2);  // the expressions follow from weights found on the neutral face alone
  }
}

TEST(BilinearCore, AModeIsOneStandardDeviation) {
  std::mt19937 random(kSeed);
  constexpr int kCount = 400;
  constexpr double kSigma = 2.5;
  const TensorSlice direction = [&] {
    TensorSlice half = random_slice(random);
    const TensorSlice other = mirrored(half, small_mirror());
    for (std::size_t mode = 0; mode < half.size(); ++mode) {
      half[mode] += other[mode];
    }
    return half;
  }();
  std::normal_distribution<double> normal(0, kSigma);
  std::vector<TensorSlice> slices;
  double sum = 0;
  double squares = 0;
  for (int s = 0; s < kCount; ++s) {
    const double weight = normal(random);
    sum += weight;
    squares += weight * weight;
    TensorSlice& slice = slices.emplace_back(direction);
    for (Eigen::Matrix3Xf& row : slice) {
      row *= static_cast<float>(weight);
    }
  }
  const double variance = squares / kCount - sum / kCount * sum / kCount;
  const BilinearCore core = truncate_identity_mode(slices, small_mirror(), unit_weights(), {0.99, 5}, [] {});
  ASSERT_EQ(core.identity_modes, 2);
  EXPECT_NEAR(inner(core.rows[1], core.rows[1]), variance * inner(direction, direction),
              1e-3 * variance * inner(direction, direction));
}

TEST(BilinearCore, StopsAtTheLargestNumberOfModes) {
  std::mt19937 random(kSeed);
  const BilinearCore core = truncate_identity_mode(low_rank_slices(random, 25, 5), small_mirror(),
                                                   unit_weights(), {0.999, 2}, [] {});
  EXPECT_EQ(core.identity_modes, 3);
  EXPECT_LT(core.explained, 0.999);
}

}  // namespace
}  // namespace facet::model
