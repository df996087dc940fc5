#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "animate/take_basis.hpp"

namespace facet::animate {

/// Control points of one pose, at most: beyond, regions are smaller than what a face moves in.
inline constexpr int kMostControls = 64;

/// How much of each region every vertex has: compressed rows, one per vertex, whose weights sum to 1.
struct RegionWeights {
  std::vector<std::int32_t> offsets;  ///< [vertex_count + 1]
  std::vector<std::uint8_t> regions;  ///< [entry_count]
  std::vector<float> weights;         ///< [entry_count] above 0

  /// The weights of one region. [vertex_count]
  Eigen::VectorXf region(int index) const;
};

/// Soft regions around control points: the normalised radial basis functions of [SF04 eq. 22],
/// B(s_n; s_l) = exp(-|s_n - s_l|^2 / r_l^2) / sum over l' of the same, r_l the distance to the nearest other
/// control point. Distances are taken on the take's mean face, so that regions depend on which control points
/// there are and not on where they are dragged: an animation keeps its regions. Evaluated at the control
/// vertices and pushed to the finest level through the stencils, whose rows sum to 1, as positions are. One
/// control point, or none: one region, the whole face. Immutable; any thread.
class InfluenceMaps {
 public:
  /// vertices: of the finest level, each once; see check_controls. whole: one region whatever their number.
  InfluenceMaps(const TakeBasis& basis, std::span<const std::int32_t> vertices, bool whole = false);

  int region_count() const { return region_count_; }
  const RegionWeights& control() const { return control_; }  ///< of the control vertices
  const RegionWeights& finest() const { return finest_; }
  /// Mean over an eyeball's vertices. [region_count][eye_count]
  const Eigen::MatrixXf& eyes() const { return eyes_; }
  /// One region's; empty where the take has no eyes.
  Eigen::VectorXf eyes_of(int region) const {
    return eyes_.cols() > 0 ? Eigen::VectorXf(eyes_.row(region)) : Eigen::VectorXf();
  }
  /// Each region's share of the whole face; sums to 1. [region_count]
  const Eigen::VectorXf& shares() const { return shares_; }
  const std::vector<std::int32_t>& vertices() const { return vertices_; }

 private:
  int region_count_;
  std::vector<std::int32_t> vertices_;
  RegionWeights control_;
  RegionWeights finest_;
  Eigen::MatrixXf eyes_;
  Eigen::VectorXf shares_;
};

/// Throws Error(Usage) where there are too many control points, one is not a vertex of the finest level, or
/// two are on one vertex.
void check_controls(const TakeBasis& basis, std::span<const std::int32_t> vertices);

/// A face between the captured ones: each region's coefficients.
struct Pose {
  std::shared_ptr<const InfluenceMaps> maps;
  /// Column per region: the coefficients of TakeBasis, then the detail coefficients that the folds are made
  /// of, which need not be those that the broader detail is made of. [coefficient_count + detail_rank]
  /// [region_count]
  Eigen::MatrixXf state;
};

/// Coefficients of a captured frame as a column of a state.
Eigen::VectorXf captured_state(const TakeBasis& basis, Eigen::Index frame);

/// The mesh of a pose: control vertices, displacements, expression; the other fields are left as they are.
/// Sizes the vectors on the first call and allocates nothing later. Any thread.
void blend(const TakeBasis& basis, const Pose& pose, mesh::MeshFrame& frame);

/// A frame with what all frames made from a take share: subject, albedo, camera, the sample's lighting,
/// confidence and pose of the head.
mesh::MeshFrame blank_frame(const TakeBasis& basis);

}  // namespace facet::animate
