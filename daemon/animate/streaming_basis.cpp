#include "animate/streaming_basis.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "maths/solve.hpp"

namespace facet::animate {
namespace {

/// Directions weaker than this part of the strongest are rounding errors of single precision.
constexpr double kRounding = 1e-5;

/// vectors^T vectors in double precision: in single, directions a thousandth as strong would drown.
Eigen::MatrixXd gram_of(const Eigen::MatrixXf& vectors) {
  constexpr Eigen::Index kRows = 2048;
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(vectors.cols(), vectors.cols());
  for (Eigen::Index row = 0; row < vectors.rows(); row += kRows) {
    const Eigen::MatrixXd part =
        vectors.middleRows(row, std::min(kRows, vectors.rows() - row)).cast<double>();
    gram.noalias() += part.transpose() * part;
  }
  return gram;
}

}  // namespace

StreamingBasis::StreamingBasis(Eigen::Index dimension, Eigen::Index max_rank)
    : max_rank_(max_rank), directions_(dimension, 0) {}

void StreamingBasis::add(const Eigen::Ref<const Eigen::MatrixXf>& block) {
  if (block.cols() == 0 || max_rank_ == 0) {
    return;
  }
  const Eigen::Index rank = directions_.cols();
  // Block = directions * inside + outside; twice, because once leaves rounding errors along the directions.
  Eigen::MatrixXf inside = directions_.transpose() * block;
  Eigen::MatrixXf outside = block - directions_ * inside;
  const Eigen::MatrixXf again = directions_.transpose() * outside;
  outside -= directions_ * again;
  inside += again;

  // outside = new directions * sqrt(weight) * mix^T, from its Gram matrix.
  const Eigen::MatrixXd gram = gram_of(outside);
  const maths::SymmetricEigen eigen = maths::symmetric_eigen(gram);
  const double scale =
      std::max(strengths_.size() > 0 ? strengths_[0] * strengths_[0] : 0.0, eigen.values.maxCoeff());
  const Eigen::Index added = (eigen.values.array() > std::max(scale * kRounding * kRounding, 1e-30)).count();
  if (rank + added == 0) {
    return;  // all zeros so far
  }
  const Eigen::MatrixXd mix = eigen.vectors.rightCols(added);
  const Eigen::VectorXd weight = eigen.values.tail(added).cwiseSqrt();

  // [directions * strengths, block] = [directions, new directions] * core
  Eigen::MatrixXd core = Eigen::MatrixXd::Zero(rank + added, rank + block.cols());
  core.topLeftCorner(rank, rank) = strengths_.asDiagonal();
  core.topRightCorner(rank, block.cols()) = inside.cast<double>();
  core.bottomRightCorner(added, block.cols()) = weight.asDiagonal() * mix.transpose();
  const maths::SymmetricEigen turned = maths::symmetric_eigen(core * core.transpose());
  const Eigen::VectorXd values = turned.values.cwiseMax(0.0).cwiseSqrt();
  const double strongest = values.size() > 0 ? values[values.size() - 1] : 0.0;
  const Eigen::Index kept =
      std::min(max_rank_, (values.array() > std::max(strongest * kRounding, 1e-15)).count());
  const Eigen::MatrixXd turn = turned.vectors.rightCols(kept).rowwise().reverse();

  const Eigen::MatrixXf new_mix =
      (mix * weight.cwiseInverse().asDiagonal() * turn.bottomRows(added)).cast<float>();
  const Eigen::MatrixXf old_mix = turn.topRows(rank).cast<float>();
  Eigen::MatrixXf next = outside * new_mix;
  next += directions_ * old_mix;
  directions_ = std::move(next);
  strengths_ = values.tail(kept).reverse();
}

Eigen::MatrixXf StreamingBasis::directions() const {
  if (directions_.cols() == 0) {
    return directions_;
  }
  // Rounding errors of many blocks add up: made orthonormal once more (Cholesky QR).
  const Eigen::MatrixXd gram = gram_of(directions_);
  const Eigen::MatrixXd upper = gram.llt().matrixU();
  const Eigen::MatrixXd back =
      upper.triangularView<Eigen::Upper>().solve(Eigen::MatrixXd::Identity(upper.rows(), upper.cols()));
  return directions_ * back.cast<float>();
}

}  // namespace facet::animate
