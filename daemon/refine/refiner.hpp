#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "gpu/batch.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/mesh_frame.hpp"
#include "refine/step_planner.hpp"

namespace facet::refine {

/// Weights of the energies [MD19 sec. 4], chosen by bench/weights (docs/decisions). Data residuals
/// are relative to the face's rms brightness, so that one set holds for every exposure, skin and image size.
struct Weights {
  float lighting_temporal = 0.05F;  ///< w1 [MD19 eq. 3], in units of what all visible vertices weigh together
  float albedo_smooth = 600.0F;     ///< w2 [MD19 eq. 4], against a vertex of mean brightness
  float albedo_smooth_known = 3000.0F;      ///< w2 where SubjectSetup::skin_albedo
  float displacement_smooth = 10.0F;        ///< w3 [MD19 eq. 6], of the squared slope (L d) / spacing
  float displacement_smooth_known = 20.0F;  ///< w3 where SubjectSetup::relief_mm
  float displacement_hierarchy = 1.0F;      ///< w4 [MD19 eq. 6], of the squared slope (pd - d) / spacing
  float displacement_coarse = 0.004F;       ///< w5 [MD19 eq. 6], of d^2 in mm^2
  float displacement_coarse_known = 0.03F;  ///< w5 where SubjectSetup::known_shape
};

/// For whom the light is that of lamps all around the room, which the head hides from itself (RoomLight), and
/// what is left of it [MD19 eq. 3].
enum class RoomLamps {
  Never,        ///< [MD19 eq. 3] alone, as in the paper
  KnownShapes,  ///< where SubjectSetup::known_shape: so many lamps would explain a guess's errors
  Always,       ///< for benchmarks, whose shapes are the truth's
};

struct RefinerConfig {
  Weights weights;
  Budget budget = Budget::Auto;
  int gauss_newton_steps = 2;  ///< on every level, Budget::Fixed
  int pcg_iterations = 7;      ///< of each step, Budget::Fixed
  int albedo_frames = 20;      ///< good frames over which the albedo is learned
  /// true: the albedo is learned on the finest level, so that brows, lips and moles are not taken for shape;
  /// false: on M0 and prolonged, as in the paper.
  bool fine_albedo = false;
  RoomLamps room_lamps = RoomLamps::KnownShapes;
  bool hierarchical = true;  ///< false: the finest level only (the paper's figure 6, for comparison)
  /// true: every frame comes with displacements that something else measured
  /// (RefineInput::prior_displacements_mm); w4 draws to them. For subjects of one level.
  bool given_prior = false;
  /// Tukey's bound on the residual relative to the face's rms brightness: what shading cannot explain
  /// (highlights, cast shadows, hair) loses its weight. 0: plain squares as in the paper.
  float robust_scale = 0.6F;
  /// Residuals are weighted by the inverse of their colour covariance over the face plus this times its mean
  /// variance: what changes colour is albedo, what changes all channels alike is shading. 1000 and more:
  /// plain squares as in the paper.
  float metric_floor = 0.1F;
  /// Bend (L d / spacing) from which on the smoothness term w3 grows linearly instead of quadratically: folds
  /// stay sharp where skin between them is kept quiet. 0: plain squares as in the paper.
  float fold_slope = 0.05F;
  /// Displacements are held within +- this: three times the coarse mesh's mean error. More is no wrinkle.
  float displacement_bound_mm = 6;
  bool record_energies = false;  ///< fill RefineOutput::energies: for convergence plots
  bool time_kernels = false;     ///< fill RefineOutput::kernels: for benchmarks; slows the frame down
};

/// What refinement errs towards where shading cannot tell folds from what colours the skin.
enum class Detail {
  Faithful,    ///< little relief that is not there: normals of strangers no worse than the coarse mesh's; the
               ///< default
  Expressive,  ///< the folds that one knows a person by, and with them some of stubble, gloss and hair line
};
/// Sets the weights and bounds of a choice (docs/decisions/refinement-weights.md).
void choose_detail(Detail detail, RefinerConfig& config);

/// What is fixed for one subject.
struct SubjectSetup {
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  mesh::Vertices mean_albedo;           ///< [3][control_vertex_count] linear RGB
  std::vector<std::uint8_t> refinable;  ///< [control_vertex_count]
  /// Albedo known from before, on this hierarchy's finest level; it is then held. Null: learned from the
  /// first frames.
  std::shared_ptr<const mesh::Albedo> albedo = nullptr;
  /// [control_vertex_count] 0 to 1: how far what shades the skin there is its shape (face::shading_trust);
  /// its product with what is seen of a vertex is the weight of its data. Empty: 1.
  std::vector<float> trust = {};
  /// The coarse mesh is of one head's own shape and no guess among many (a face model without identities:
  /// a person's, learned or enrolled): it is nearer, and what shading says against it counts for less.
  bool known_shape = false;
  /// Relief of the face at rest known from before, [finest vertex_count] along the normals, mm: displacements
  /// begin there, and w3, w4 and w5 count from there on. Empty: none.
  std::vector<float> relief_mm = {};
  /// The skin's albedo known from another session, in that one's hue: [3][finest vertex_count] linear RGB.
  /// The mean albedo is brought to its tone, as far as that is wider than 15 mm, and what is handed out is
  /// this one in the hue that frames teach. Empty: mean_albedo.
  mesh::Vertices skin_albedo = {};
};

/// What a camera beside the reference camera adds to a frame.
struct FurtherCamera {
  Frame image;              ///< of the camera's size; empty: it says nothing of this frame
  CameraIntrinsics camera;  ///< with the size of its images, always
  Eigen::Isometry3f view_from_reference = Eigen::Isometry3f::Identity();  ///< camera frames, mm
};

struct RefineInput {
  Frame image;  ///< empty: this camera says nothing of this frame, further_views do
  CameraIntrinsics camera;
  Eigen::Isometry3f camera_from_head;
  /// [3][control_vertex_count] head frame; read during submit only.
  const mesh::Vertices* control_vertices_mm = nullptr;
  /// [control_vertex_count] along the normals of the coarsest level; where RefinerConfig::given_prior, else
  /// empty. Read during submit only.
  std::span<const float> prior_displacements_mm = {};
  /// Cameras beside `camera`, whose frame everything stands in; the same ones in every frame.
  std::span<const FurtherCamera> further_views = {};
  /// false: `image` does not show the face well enough to be believed, the other cameras' do.
  bool image_counts = true;
  /// Budget::Auto thins the solve out until submit to collect takes no longer; 0: no limit.
  float time_limit_ms = 0;
};

enum class RefineOutcome {
  Refined,
  NumericalFailure,  ///< the solve gave non-finite values; the output holds the coarse mesh (displacements 0)
  DeviceLost,        ///< the context must be rebuilt and a new Refiner made; the output is empty
};

struct RefineOutput {
  std::vector<float> displacements_mm;  ///< [finest vertex_count]
  std::vector<float> confidence;        ///< [finest vertex_count] 0 to 1
  /// [MD19 eq. 1]; of the room's lamps what nine coefficients come nearest to, where the skin faces the
  /// camera.
  std::array<float, 9> lighting{};
  /// The current one; same object while unchanged. With SubjectSetup::skin_albedo not what was solved with,
  /// but that one in the hue taught.
  std::shared_ptr<const mesh::Albedo> albedo;
  float photometric_rms = 0;
  std::vector<int> steps;  ///< [level] Gauss-Newton steps made; 0: interpolated from the coarser level
  std::string given_up;    ///< what the time limit took, for people; empty where nothing
  float upload_ms = 0;
  float lighting_ms = 0;
  float albedo_ms = 0;
  float displacement_ms = 0;
  float readback_ms = 0;
  float recording_ms = 0;  ///< of the host, while the frame waited: recording a plan of steps not met before
  std::string failure;     ///< for people, empty where Refined
  std::vector<gpu::StageTime> kernels;  ///< only with time_kernels: every step, "stage/level/kernel"
  /// Only with record_energies: [level][step] E(d) [MD19 eq. 6] before each Gauss-Newton step and after the
  /// last.
  std::vector<std::vector<double>> energies;
};

/// Hierarchical shading refinement on the GPU [MD19 sec. 4]. One thread. submit hands a frame
/// to the GPU and returns; collect waits for it. One frame may be in flight. A whole frame is one submission:
///   image -> linear pyramid; coarse mesh -> positions, depth map, colours of M0; light [MD19 eq. 3];
///   while it learns, albedo [MD19 eq. 4]; then level by level positions, colours, displacements
///   [MD19 eq. 5-8].
/// Further cameras' images take the same way up to the colours; a vertex then has the mean of what all see.
/// Before all that the host finds the room's lamps (RoomLight: milliseconds, half a megabyte allocated and
/// more where they are solved). Nothing else is allocated per frame but for the first frame, a change of the
/// images' sizes or number, and a new albedo to hand out (every frame while it is learned, rarely
/// afterwards). Plans of steps (Budget::Auto) that may come next are recorded behind a submitted frame, one a
/// frame, while the device is at work.
class Refiner {
 public:
  /// Compiles the kernels. Throws Error(NoDevice). The context must outlive the refiner.
  Refiner(gpu::Context& context, const RefinerConfig& config);
  ~Refiner();

  /// Sets or replaces the subject: uploads topology and stencils, forgets albedo, lighting and displacements.
  /// Not while in flight.
  void set_subject(const SubjectSetup& subject);

  /// Starts a frame. Throws Error(Usage) without a subject, for an empty image and no further views, for
  /// vertices or given displacements that do not fit the subject, for a further view's image of another size
  /// than its camera's; Error(NoDevice) where a first image finds no room on the device.
  void submit(const RefineInput& input);

  /// Waits for the frame in flight. `output` is resized as needed and best used again. With DeviceLost, or
  /// where nothing is in flight, `failure` says so.
  RefineOutcome collect(RefineOutput& output);

  /// Forgets the previous frame's displacements and light, not the albedo nor the room's lamps (which find
  /// out by themselves where they are others): for a cut or a face that comes back.
  void restart();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::refine
