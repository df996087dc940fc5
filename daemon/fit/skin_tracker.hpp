#pragma once

#include <memory>
#include <span>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "fit/template_fitter.hpp"
#include "fit/template_mesh.hpp"

namespace facet::fit {

struct SkinTrackerOptions {
  FitOptions fit;
  /// What docs/template-fit.md, "Drift", adds to the paper; off for comparisons.
  bool redraws = true;         ///< the picture before, where the mesh is found
  bool uses_reference = true;  ///< the first picture, too
  /// Tukey's, of flow from the first picture: it may be of something else by now.
  float reference_sigma_px = 4;
};

/// Follows one person's skin from slot to slot: the template on the depth maps, every vertex on the point of
/// the skin that it lay on in the first slot ([SF04 sec. 3.2]; docs/template-fit.md). One thread
/// at a time.
///
/// maps: of one slot. pictures: [cameras] of the same slot in the order of `lenses`, RGBA; empty or corrupt
/// ones are no pictures. Where a call's report says that the face is lost, all stays as it was before it, and
/// the next slot is one for find_again or start.
class SkinTracker {
 public:
  /// lenses: of the cameras that see texture. projectors: that light blank slots
  SkinTracker(std::shared_ptr<const TemplateMesh> surface, std::vector<capture::Lens> lenses,
              std::vector<capture::Lens> projectors, const SkinTrackerOptions& options);
  ~SkinTracker();

  /// A new person: fits the template as it was placed; the result less the expression that it was placed with
  /// is the shape at rest from now on, the pictures are what its skin looks like.
  TemplateFitReport start(const Placement& placed, std::span<const capture::DepthMap> maps,
                          std::span<const Frame> pictures);
  /// The slot after. Needs a start.
  TemplateFitReport follow(std::span<const capture::DepthMap> maps, std::span<const Frame> pictures);
  /// The person of before, after a gap: begins with its own shape where the template was placed anew, and
  /// draws every vertex to its skin. Needs a start.
  TemplateFitReport find_again(const Placement& placed, std::span<const capture::DepthMap> maps,
                               std::span<const Frame> pictures);

  /// Whether `between` has two slots to go between: the last call followed the one before it.
  bool follows() const;
  /// A slot without texture between the last two: the way between their meshes, and off it where the slot's
  /// depth maps pull (TemplateFitter::settle). Nothing else changes. Throws Error(Usage) unless follows().
  /// fraction     of the time from the one to the other, 0 to 1
  /// vertices_mm  out, [3][vertex_count] rig frame
  /// expression   out, [expression_count]
  TemplateFitReport between(double fraction, std::span<const capture::DepthMap> maps,
                            mesh::Vertices& vertices_mm, Eigen::VectorXd& expression);

  /// [3][vertex_count] of the last slot that was not lost, rig frame.
  const mesh::Vertices& vertices_mm() const;
  /// [expression_count], of the last slot.
  const Eigen::VectorXd& expression() const;
  /// [vertex_count] how strongly depth maps pull a vertex, of the last call.
  const std::vector<float>& depth_weight() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::fit
