#include "animate/region_metric.hpp"

#include <algorithm>
#include <cmath>

#include "maths/solve.hpp"

namespace facet::animate {
namespace {

constexpr float kEyeballRadius_mm = 12;

/// A square root of sum over v of weights[v] * directions(:, v) directions(:, v)^T / sum of weights, where
/// each weight counts for `axes` columns.
Eigen::MatrixXf root_of_gram(const TakeBasis::MatrixView& directions, const Eigen::VectorXf& weights,
                             Eigen::Index axes) {
  const Eigen::Index rank = directions.rows();
  if (rank == 0) {
    return {};
  }
  constexpr Eigen::Index kBlock = 512;
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(rank, rank);
  Eigen::MatrixXf block(rank, kBlock);
  Eigen::Index filled = 0;
  const auto add = [&] {
    const Eigen::MatrixXf part = block.leftCols(filled) * block.leftCols(filled).transpose();
    gram += part.cast<double>();
    filled = 0;
  };
  double total = 0;
  for (Eigen::Index v = 0; v < weights.size(); ++v) {
    if (weights[v] <= 0) {
      continue;
    }
    total += static_cast<double>(weights[v]);
    const float root = std::sqrt(weights[v]);
    for (Eigen::Index axis = 0; axis < axes; ++axis) {
      block.col(filled++) = root * directions.col(axes * v + axis);
      if (filled == kBlock) {
        add();
      }
    }
  }
  add();
  const maths::SymmetricEigen eigen = maths::symmetric_eigen(gram / std::max(total, 1e-12));
  const Eigen::MatrixXd root =
      eigen.values.cwiseMax(0.0).cwiseSqrt().asDiagonal() * eigen.vectors.transpose();
  return root.cast<float>();
}

}  // namespace

RegionMetric::RegionMetric(const TakeBasis& basis, const Eigen::VectorXf& control_weights,
                           const Eigen::VectorXf& finest_weights, const Eigen::VectorXf& eye_weights) {
  const Eigen::Index coarse = basis.coarse_rank();
  const Eigen::Index detail = basis.detail_rank();
  transform_ = Eigen::MatrixXf::Zero(basis.expression_offset(), basis.expression_offset());
  transform_.topLeftCorner(coarse, coarse) = root_of_gram(basis.coarse(), control_weights, 3);
  if (detail > 0) {
    transform_.block(coarse, coarse, detail, detail) = root_of_gram(basis.detail(), finest_weights, 1);
  }
  // An eyeball counts by its share of the vertices.
  const float total = std::max(control_weights.sum(), 1e-12F);
  for (Eigen::Index e = 0; e < basis.eye_count(); ++e) {
    const auto eye = basis.eye_of_vertex();
    const auto vertices =
        static_cast<float>(std::count(eye.begin(), eye.end(), static_cast<std::uint8_t>(e + 1)));
    const float share = std::sqrt(std::max(0.0F, eye_weights[e]) * vertices / total);
    const Eigen::Index at = basis.eye_offset() + 6 * e;
    transform_.diagonal().segment<3>(at).setConstant(share * kEyeballRadius_mm);
    transform_.diagonal().segment<3>(at + 3).setConstant(share);
  }
}

RegionMetric::RegionMetric(const TakeBasis& basis)
    : RegionMetric(basis, Eigen::VectorXf::Ones(basis.control_count()),
                   Eigen::VectorXf::Ones(basis.finest_count()), Eigen::VectorXf::Ones(basis.eye_count())) {}

}  // namespace facet::animate
