#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "report/evaluation.hpp"

namespace facet::report {

/// How far vertices are from the skin points that they lay on at first. NaN where it can't be said.
struct SkinPointFigures {
  double mean_mm = 0;        ///< over all points of all frames after the first
  double p95_mm = 0;         ///<
  double tangential_mm = 0;  ///< mean of the part along the skin
  /// Means over the first and last fifth of the frames; their difference is the drift.
  double first_fifth_mm = 0;
  double last_fifth_mm = 0;
  double slope_mm_per_10_s = 0;  ///< of the frames' means over their time
  std::uint64_t points = 0;
  double drift_mm() const { return last_fifth_mm - first_fifth_mm; }
};

/// Follows skin points of the truth, whose triangles are the same in all frames: each vertex measured in the
/// first frame is pinned to the point (triangle and barycentric) of the truth that is nearest to it there; in
/// later frames its distance to where that same point has gone is measured, while the vertex is measured. A
/// vertex that is first seen later is not followed: it would have had less time to drift. A new subject,
/// whose vertices are others, is pinned anew in its first frame. One thread.
class SkinPointSum {
 public:
  /// Adds the next frame.
  ///
  /// subject      Subject::id
  /// time_s       of the picture
  /// comparison   of this reconstruction with this truth
  /// each         told vertex and distance of every point, in mm; may be empty
  void add(std::uint64_t subject, double time_s, const Reconstruction& reconstruction,
           const Comparison& comparison, const simulation::TruthMesh& truth,
           const std::function<void(std::int32_t vertex, double mm)>& each = {});

  SkinPointFigures figures() const;
  /// Why there are no figures; empty where there are some.
  std::string missing() const;
  /// The points of the truth that the vertices of the last subject are pinned to, and on that mesh. triangle
  /// -1: not pinned.
  struct Pin {
    std::int32_t triangle = -1;
    Eigen::Vector2f barycentric{0, 0};
  };
  const std::vector<Pin>& pins() const { return pins_; }
  /// Whether a mesh has the triangles that the pins are on.
  bool has_topology_of(const simulation::TruthMesh& truth) const;

 private:
  void pin(const Reconstruction& reconstruction, const Comparison& comparison);

  std::uint64_t subject_ = 0;
  mesh::Triangles triangles_;
  Eigen::Index truth_vertices_ = 0;
  bool topology_changes_ = false;
  std::vector<Pin> pins_;  ///< [vertex]
  std::vector<std::uint64_t> histogram_;
  std::uint64_t count_ = 0;
  double sum_mm_ = 0;
  double sum_tangential_mm_ = 0;
  std::vector<double> frame_times_s_;
  std::vector<double> frame_means_mm_;
};

}  // namespace facet::report
