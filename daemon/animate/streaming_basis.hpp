#pragma once

#include <Eigen/Core>

namespace facet::animate {

/// The strongest directions of vectors that come in blocks: an incremental singular value decomposition
/// [Bra02; RLLY08] (without their moving mean: the caller subtracts a reference).
/// Memory is that of max_rank vectors and two blocks, however many come. One thread.
class StreamingBasis {
 public:
  /// dimension: numbers of a vector; max_rank: directions kept between blocks.
  StreamingBasis(Eigen::Index dimension, Eigen::Index max_rank);

  /// block [dimension][any number of vectors]; every number finite.
  void add(const Eigen::Ref<const Eigen::MatrixXf>& block);

  /// Orthonormal within 1e-5, strongest first. [dimension][rank]
  Eigen::MatrixXf directions() const;
  /// Singular values, falling. [rank]
  const Eigen::VectorXd& strengths() const { return strengths_; }

 private:
  Eigen::Index max_rank_;
  Eigen::MatrixXf directions_;
  Eigen::VectorXd strengths_;
};

}  // namespace facet::animate
