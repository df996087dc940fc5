#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "animate/take_basis.hpp"

namespace facet::animate {

/// The most control points that one pose may have. With more of them a region would be smaller than the parts
/// of a face that move as one.
inline constexpr int kMostControls = 64;

/// How much of each region every vertex has: compressed rows, one per vertex, whose weights sum to 1.
struct RegionWeights {
  std::vector<std::int32_t> offsets;  ///< [vertex_count + 1]
  std::vector<std::uint8_t> regions;  ///< [entry_count]
  std::vector<float> weights;         ///< [entry_count] above 0

  /// The weights of one region. [vertex_count]
  Eigen::VectorXf region(int index) const;
};

/// Soft regions, one around each control point. The weight of region l at a vertex is a normalised radial
/// basis function, [SF04 eq. 22]:
///
///   B(s_n; s_l) = exp(-|s_n - s_l|^2 / r_l^2) / sum over all l' of exp(-|s_n - s_l'|^2 / r_l'^2)
///
/// s_n is the vertex's place and s_l that of control point l, mm; r_l is the distance from s_l to the nearest
/// other control point, mm. All places are those of the take's mean face. Regions depend therefore on which
/// control points there are and not on where they are dragged: an animation keeps its regions. B is computed
/// at the control vertices. The finest level's weights follow from these through the stencils, as positions
/// do; since a stencil's weights sum to 1, those of a vertex do on the finest level, too.
///
/// Where there is one control point, or none, the whole face is one region. Immutable; any thread.
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
  /// [coefficient_count + detail_rank][region_count] One column per region. Its first rows are the
  /// coefficients of TakeBasis, in their order. Its last detail_rank rows are a second set of detail
  /// coefficients: the folds (TakeBasis::folds) are made of these; detail broader than folds is made of the
  /// first set.
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
