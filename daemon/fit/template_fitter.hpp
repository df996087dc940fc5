#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "fit/template_mesh.hpp"

namespace facet::fit {

/// Where the skin moved between two pictures of one camera.
struct FlowView {
  capture::Lens lens;  ///< of the pictures
  int width_px = 0;
  int height_px = 0;
  /// [height_px][width_px] from a pixel of the earlier picture to where it is in the later one.
  std::span<const Eigen::Vector2f> flow_px;
  std::span<const float> confidence;  ///< [height_px][width_px] 0 where nothing is known, up to 1
  /// [3][vertex_count] the mesh that the flow leads away from, rig frame; null: the one before. A flow from a
  /// ReferencePicture leads away from the mesh that it was drawn with.
  const mesh::Vertices* from_mm = nullptr;
  float sigma_px = 0;  ///< Tukey's; 0: the options'
};

/// What [SF04 sec. 3] minimises, and its constants.
struct FitOptions {
  double alpha = 2.0;      ///< of E_r [SF04 eq. 12]
  double beta = 0.1;       ///< of E_m [SF04 eq. 14]
  double sigma_m_px = 20;  ///< Tukey's, of motion [SF04 eq. 13]
  /// Tukey's, of depth [SF04 eq. 10]: of a mesh that is about right, and of one that landmarks or the slot
  /// before placed. The paper has 20 for all: beside the nose a vertex is pulled to the cheek behind it then,
  /// and slides backwards along the nose.
  double sigma_s_mm = 4;
  double placing_sigma_s_mm = 20;
  /// Of what ties a vertex to where its last velocity leads (past the paper), and Tukey's sigma of that: a
  /// vertex that does otherwise by more is not held. Needs TemplateFitter::remember.
  double gamma = 0.05;
  double sigma_t_mm = 1;
  int steps = 6;  ///< Gauss-Newton, at most, of `fit` as many again; ends early once no vertex moves by more
                  ///< than 0.005 mm
  int cg_iterations = 60;  ///< per step, at most
  /// Gauss-Newton over pose and expressions alone before those over all vertices, at most (past the paper);
  /// they end early once no vertex moves by more than 0.02 mm.
  int model_steps = 4;
  /// Where the data turn triangles over, E_r alone decides (past the paper).
  bool unfolds = true;
  /// What E_r compares with follows the mesh found before each step, so that it tells bending from turning
  /// and from what the model knows of faces (past the paper, where it is the template as it was placed).
  bool turns_with_the_head = true;
  bool knows_expressions = true;
  /// Of the expressions' weights, as a standard deviation: how far they are looked for from 0.
  double expression_sigma = 0.5;
};

enum class TemplateFitOutcome {
  Converged,         ///< no vertex moves by more than 0.005 mm any more
  NotConverged,      ///< the steps are used up
  NoData,            ///< too few vertices see a depth: fewer than a twentieth
  NumericalFailure,  ///< a number is not finite; the vertices are those given
};

constexpr const char* to_string(TemplateFitOutcome outcome) {
  constexpr std::array kNames = {"converged", "not converged", "no data", "numerical failure"};
  return kNames.at(static_cast<std::size_t>(outcome));
}

struct TemplateFitReport {
  TemplateFitOutcome outcome = TemplateFitOutcome::NotConverged;
  std::string failure;  ///< for people; empty where all is well
  int steps = 0;
  double last_move_mm = 0;    ///< largest of the last step
  double surface_rms_mm = 0;  ///< along the depth axis, over what counts
  double motion_rms_px = 0;   ///< of the flow, over what counts; 0 without flow
  double seen = 0;            ///< share of the skin's vertices that a depth map pulls
  double followed = 0;        ///< share that a flow pulls
  double rejected = 0;  ///< share of the skin's vertices on a map that lie more than 5 mm off its surface
  /// Of the skin that depth maps pull, from the shape at rest in the pose and with the expression that come
  /// closest: where it is large this is somebody else's face.
  double shape_rms_mm = 0;
  double flow_trust = 0;  ///< mean confidence of the flows where they see skin; 0 without flow
  /// The mesh is not on the face: too little of it seen, too much off the surface, or no flow comes back to
  /// where it began. It is to be placed again (TemplateFitter::shape_like).
  bool lost = false;
  std::string lost_because;  ///< for people; empty unless lost
  int unfolded = 0;          ///< vertices that the data would have folded and E_r decided on
  /// Of the skin around the mouth, which tears first: the rms over edges of how far they bend from what E_r
  /// compares with, over their length; and the share of the vertices on a map that lie more than 5 mm off it.
  double mouth_bend = 0;
  double mouth_off = 0;
  double tear() const { return std::max(mouth_bend / kTornBend, mouth_off / kTornOff); }
  /// One of both is larger than a sound mesh's: at most 0.17 and 0.057 in 14 first slots of heads of another
  /// model, above one of these bounds in all 13 whose mouth was torn (docs/decisions/booth-start.md).
  bool torn() const { return tear() > 1; }
  static constexpr double kTornBend = 0.22;
  static constexpr double kTornOff = 0.062;
};

/// Fits the template to depth maps, and follows the skin through a take. One thread at a time.
class TemplateFitter {
 public:
  TemplateFitter(std::shared_ptr<const TemplateMesh> surface, const FitOptions& options);
  ~TemplateFitter();

  /// The shape that E_r compares with from now on: the template as it was placed, later as it was fitted.
  /// Needed before the first fit. Throws Error(Usage) where it has other vertices than the template.
  void set_rest(RestShape rest);

  /// [SF04 eq. 10-12]: deforms the template, as landmarks placed it, onto the depth maps: first with depth
  /// that pulls from afar (FitOptions::placing_sigma_s_mm), then with what is near.
  /// vertices_mm  [3][vertex_count] rig frame; in: where to begin, out: the result
  TemplateFitReport fit(std::span<const capture::DepthMap> maps, mesh::Vertices& vertices_mm);

  /// Pose and expression alone, by depth from afar and then by what is near, and by flow, as they are from
  /// one slot to the next. vertices_mm stays as it is where hardly any of it is seen. Arguments as for track.
  void move(std::span<const capture::DepthMap> maps, std::span<const FlowView> flows,
            const mesh::Vertices& before_mm, mesh::Vertices& vertices_mm);

  /// [SF04 eq. 13, 14]. Onto the depth maps, and every vertex goes where the flow says that its skin went.
  /// flows        of the cameras that see texture
  /// before_mm    [3][vertex_count] the result for the earlier picture
  /// vertices_mm  as above
  TemplateFitReport track(std::span<const capture::DepthMap> maps, std::span<const FlowView> flows,
                          const mesh::Vertices& before_mm, mesh::Vertices& vertices_mm);

  /// Past the paper, whose meshes are of blank slots alone: a slot without a picture of the texture, between
  /// two that have one. Depth maps [SF04 eq. 10] pull the skin along the surface's normals; along the
  /// surface it stays where it is expected, and what E_r [SF04 eq. 11] compares with is the mesh expected.
  /// expected_mm  [3][vertex_count] rig frame, such as a mean of the meshes before and after
  /// vertices_mm  out
  TemplateFitReport settle(std::span<const capture::DepthMap> maps, const mesh::Vertices& expected_mm,
                           mesh::Vertices& vertices_mm);

  /// The result for a slot, once it is final: the next slot's vertices are expected to go on as they went.
  /// [3] [vertex_count], rig frame. Throws Error(Usage) where it has other vertices than the template.
  void remember(const mesh::Vertices& vertices_mm);
  /// Expects nothing from the slots before: after a gap, or once lost. set_rest does so, too.
  void forget();

  /// The person's own rest shape in the pose and with the expression that come closest to another mesh, such
  /// as the template placed by landmarks once more: where to begin after a gap, with the correspondence, rest
  /// shape and reference pictures of before. [3][vertex_count] both, rig frame.
  mesh::Vertices shape_like(const mesh::Vertices& other_mm);

  /// Of the last call: [vertex_count] how strongly depth maps pull a vertex, 0 where none sees it.
  const std::vector<float>& depth_weight() const;
  /// [expression_count] weights of the expressions in the shape that E_r compared with last.
  const Eigen::VectorXd& expression() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::fit
