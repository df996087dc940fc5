#include "animate/face_sums.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <utility>
#include <vector>

#include "maths/solve.hpp"

namespace facet::animate {
namespace {

constexpr Eigen::Index kMostDimensions = 3;
/// Of the lattice, mm or px: at first, and from one try to the next.
constexpr double kFinestSpacing = 0.1;
constexpr double kCoarser = 1.2;
/// Cells counted from the origin, per axis; beyond, numbers make no cell.
constexpr std::int64_t kMostCells = 1 << 20;

}  // namespace

FaceSums::FaceSums(Eigen::MatrixXd captured, const TakeBasis::MatrixView& coefficients, bool exact)
    : captured_(std::move(captured)), coefficients_(coefficients) {
  if (exact || captured_.cols() <= kMostFaces || captured_.rows() > kMostDimensions ||
      !captured_.allFinite()) {
    return;
  }
  origin_ = captured_.rowwise().mean();
  const Eigen::MatrixXd apart = captured_.colwise() - origin_;
  axes_ = maths::symmetric_eigen(apart * apart.transpose()).vectors;
  const double reach = apart.cwiseAbs().maxCoeff() * std::sqrt(static_cast<double>(kMostDimensions));
  double spacing = std::max(kFinestSpacing, 2 * reach / static_cast<double>(kMostCells));
  while (!find_nodes(spacing)) {
    spacing *= kCoarser;
  }
  gather();
}

/// False, with nothing made, where the lattice would have more than kMostNodes nodes with faces.
bool FaceSums::find_nodes(double spacing) {
  const Eigen::Index dimensions = captured_.rows();
  const Eigen::Index corner_count = Eigen::Index{1} << dimensions;
  corners_.resize(corner_count, captured_.cols());
  shares_.resize(corner_count, captured_.cols());
  std::unordered_map<std::int64_t, int> node_of;
  std::vector<Eigen::VectorXd> at;
  Eigen::VectorXd low(dimensions);
  Eigen::VectorXd part(dimensions);
  Eigen::VectorXd corner(dimensions);
  for (Eigen::Index f = 0; f < captured_.cols(); ++f) {
    part = axes_.transpose() * (captured_.col(f) - origin_) / spacing;
    low = part.array().floor();
    part -= low;
    for (Eigen::Index c = 0; c < corner_count; ++c) {
      double share = 1;
      std::int64_t key = 0;
      for (Eigen::Index axis = 0; axis < dimensions; ++axis) {
        const bool upper = ((c >> axis) & 1) != 0;
        share *= upper ? part[axis] : 1 - part[axis];
        corner[axis] = low[axis] + (upper ? 1 : 0);
        key = 2 * kMostCells * key + static_cast<std::int64_t>(corner[axis]) + kMostCells;
      }
      const auto [entry, is_new] = node_of.try_emplace(key, static_cast<int>(at.size()));
      if (is_new) {
        if (static_cast<Eigen::Index>(at.size()) == kMostNodes) {
          return false;
        }
        at.emplace_back(spacing * corner);
      }
      corners_(c, f) = entry->second;
      shares_(c, f) = static_cast<float>(share);
    }
  }
  nodes_.resize(dimensions, static_cast<Eigen::Index>(at.size()));
  for (std::size_t j = 0; j < at.size(); ++j) {
    nodes_.col(static_cast<Eigen::Index>(j)) = at[j];
  }
  return true;
}

void FaceSums::gather() {
  const Eigen::Index dimensions = captured_.rows();
  const Eigen::Index numbers = coefficients_.rows();
  counts_ = Eigen::VectorXd::Zero(nodes_.cols());
  first_moments_ = Eigen::MatrixXd::Zero(dimensions, nodes_.cols());
  second_moments_ = Eigen::MatrixXd::Zero(dimensions * dimensions, nodes_.cols());
  node_sums_ = Eigen::MatrixXf::Zero((1 + dimensions) * numbers, nodes_.cols());
  Eigen::VectorXd at(dimensions);
  Eigen::MatrixXd square(dimensions, dimensions);
  Eigen::VectorXf face(node_sums_.rows());
  for (Eigen::Index f = 0; f < captured_.cols(); ++f) {
    at = axes_.transpose() * (captured_.col(f) - origin_);
    square = at * at.transpose();
    face.head(numbers) = coefficients_.col(f);
    for (Eigen::Index axis = 0; axis < dimensions; ++axis) {
      face.segment((1 + axis) * numbers, numbers) = static_cast<float>(at[axis]) * coefficients_.col(f);
    }
    for (Eigen::Index c = 0; c < corners_.rows(); ++c) {
      const Eigen::Index node = corners_(c, f);
      const float share = shares_(c, f);
      counts_[node] += static_cast<double>(share);
      first_moments_.col(node) += static_cast<double>(share) * at;
      second_moments_.col(node) += static_cast<double>(share) * square.reshaped();
      node_sums_.col(node) += share * face;
    }
  }
}

Eigen::VectorXd FaceSums::node_weights(const Eigen::VectorXd& p) const {
  const Eigen::VectorXd at = axes_.transpose() * (p - origin_);
  const Eigen::VectorXd proximity =
      (1.0 + (nodes_.colwise() - at).colwise().norm().array()).inverse().transpose();
  return proximity / counts_.dot(proximity);
}

FaceSums::Result FaceSums::at(const Eigen::VectorXd& p) const {
  const Eigen::Index dimensions = captured_.rows();
  const Eigen::Index numbers = coefficients_.rows();
  Result out;
  if (is_gathered()) {
    const Eigen::VectorXd proximity = node_weights(p);
    const Eigen::VectorXd mean = first_moments_ * proximity;
    const Eigen::MatrixXd square = (second_moments_ * proximity).reshaped(dimensions, dimensions);
    const Eigen::VectorXf sums = node_sums_ * proximity.cast<float>();
    out.mean = origin_ + axes_ * mean;
    out.covariance = axes_ * (square - mean * mean.transpose()) * axes_.transpose();
    out.average = sums.head(numbers);
    out.moments = (sums.tail(dimensions * numbers).reshaped(numbers, dimensions) -
                   out.average * mean.cast<float>().transpose()) *
                  axes_.cast<float>().transpose();
    return out;
  }
  const Eigen::VectorXd weight = weights(p);
  out.mean = captured_ * weight;
  const Eigen::MatrixXd apart = captured_.colwise() - out.mean;
  const Eigen::MatrixXd weighted = apart * weight.asDiagonal();
  out.covariance = weighted * apart.transpose();
  Eigen::MatrixXf factors(captured_.cols(), 1 + dimensions);
  factors.col(0) = weight.cast<float>();
  factors.rightCols(dimensions) = weighted.transpose().cast<float>();
  const Eigen::MatrixXf sums = coefficients_ * factors;
  out.average = sums.col(0);
  out.moments = sums.rightCols(dimensions);
  return out;
}

Eigen::VectorXd FaceSums::weights(const Eigen::VectorXd& p) const {
  if (!is_gathered()) {
    const Eigen::VectorXd proximity =
        (1.0 + (captured_.colwise() - p).colwise().norm().array()).inverse().transpose();
    return proximity / proximity.sum();
  }
  const Eigen::VectorXd of_node = node_weights(p);
  Eigen::VectorXd out = Eigen::VectorXd::Zero(captured_.cols());
  for (Eigen::Index f = 0; f < out.size(); ++f) {
    for (Eigen::Index c = 0; c < corners_.rows(); ++c) {
      out[f] += static_cast<double>(shares_(c, f)) * of_node[corners_(c, f)];
    }
  }
  return out;
}

}  // namespace facet::animate
