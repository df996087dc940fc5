#include "pipeline/performance_tracker.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <list>
#include <optional>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "fit/fine_surface.hpp"
#include "fit/optical_flow.hpp"
#include "fit/reference_picture.hpp"
#include "fit/template_mesh.hpp"
#include "pipeline/face_in_space.hpp"
#include "pipeline/subject_builder.hpp"
#include "pipeline/vertex_texture.hpp"

namespace facet::pipeline {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kLeastLandmarks = 60;
constexpr int kPlacingSteps = 30;
constexpr int kPlacingCgIterations = 200;
/// Of the first fit: farther from the depth maps, or with less of the skin on them, it is no face.
constexpr double kPlacedRms_mm = 2;
constexpr double kPlacedSeen = 0.15;
/// Of a mesh that is followed.
constexpr double kFollowedRms_mm = 2.5;
constexpr double kFollowedSeen = 0.1;
/// Slots without a mesh after which the face is looked for again.
constexpr int kMostGaps = 3;
/// How far behind the mesh's own surface a vertex counts as hidden.
constexpr float kVisibleMargin_mm = 4;

float ms_since(Clock::time_point start) {
  return std::chrono::duration<float, std::milli>(Clock::now() - start).count();
}

/// Of a lens whose pictures had their distortion taken out.
CameraIntrinsics intrinsics_of(const capture::Lens& lens) {
  return {static_cast<float>(lens.fx_px),
          static_cast<float>(lens.fy_px),
          static_cast<float>(lens.cx_px),
          static_cast<float>(lens.cy_px),
          lens.width_px,
          lens.height_px};
}

/// A camera that sees texture, and what is remembered of its pictures.
struct View {
  View(const capture::Rig& rig, std::size_t given_index, track::Landmarker given_landmarker)
      : camera(&rig.cameras[given_index]), index(given_index), landmarker(std::move(given_landmarker)) {}

  const capture::RigCamera* camera;
  std::size_t index;  ///< in the rig
  track::Landmarker landmarker;
  fit::OpticalFlow flow;
  fit::Flow found;
  Frame before;  ///< empty where the slot before had none
  std::optional<fit::ReferencePicture> reference;
};

}  // namespace

struct PerformanceTracker::Impl {
  Impl(std::shared_ptr<const face::FaceModel> given_model, const std::filesystem::path& assets,
       std::shared_ptr<const capture::Rig> given_rig, const fit::FitOptions& given_options);

  std::shared_ptr<const face::FaceModel> model;
  std::shared_ptr<const capture::Rig> rig;
  fit::FitOptions options;
  std::shared_ptr<const fit::TemplateMesh> surface;
  fit::TemplateFitter fitter;
  fit::FineSurface fine;
  mesh::Vertices control_mm;      ///< of the model's mean face, head frame
  Eigen::VectorXd rigid_weights;  ///< [vertex_count] 1 on skin that expressions hardly move
  std::list<View> views;          ///< colour cameras

  std::shared_ptr<const mesh::Subject> subject;  ///< null: nobody is followed
  std::uint32_t subject_count = 0;
  Eigen::Matrix3Xd rest_mm;             ///< [3][vertex_count] the person in the first slot, head frame
  mesh::Vertices now_mm;                ///< rig frame
  int gaps = 0;                         ///< slots since the last mesh
  std::vector<float> displacements_mm;  ///< [finest vertex_count]
  std::vector<float> confidence;
  VertexTexture texture;
  Eigen::Matrix3Xf normals;  ///< of now_mm
  mesh::Vertices fine_mm;    ///< [3][finest vertex_count] rig frame
  Eigen::Matrix3Xf fine_normals;
  std::vector<std::uint8_t> visible;
  std::vector<std::uint8_t> drawn;

  const Frame& picture(const FrameSet& set, const View& view) const { return set.frames.at(view.index); }
  std::string place(const FrameSet& set, std::span<const capture::DepthMap> maps, mesh::MeshFrame& out);
  std::string follow(const FrameSet& set, std::span<const capture::DepthMap> maps);
  fit::FitReport follow_flow(const FrameSet& set, std::span<const capture::DepthMap> maps);
  void refine(const FrameSet& set, std::span<const capture::DepthMap> maps, mesh::MeshFrame& out);
  void remember(const FrameSet& set);
  void forget_pictures();
  void fill(mesh::MeshFrame& out);
};

PerformanceTracker::Impl::Impl(std::shared_ptr<const face::FaceModel> given_model,
                               const std::filesystem::path& assets,
                               std::shared_ptr<const capture::Rig> given_rig,
                               const fit::FitOptions& given_options)
    : model(std::move(given_model)),
      rig(std::move(given_rig)),
      options(given_options),
      surface(std::make_shared<const fit::TemplateMesh>(fit::make_template(*model))),
      fitter(surface, options),
      fine(model->control, surface) {
  model->evaluate({}, {}, control_mm);
  // Expressions move the upper face little: what lies above the mouth's corners by the neutral face.
  const auto mouth = static_cast<std::size_t>(61);  // the mouth's corner in MediaPipe's order
  const float mouth_y = face::FaceModel::anchor_point(model->landmarks.at(mouth), control_mm).y();
  rigid_weights.resize(surface->vertex_count());
  for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
    const bool counts =
        surface->is_skin[static_cast<std::size_t>(v)] != 0 && surface->neutral_mm(1, v) > mouth_y + 20;
    rigid_weights[v] = counts ? 1 : 0;
  }
  track::LandmarkerConfig landmarks;
  landmarks.smooth = false;
  for (std::size_t i = 0; i < rig->cameras.size(); ++i) {
    if (rig->cameras[i].colour) {
      views.emplace_back(*rig, i, track::Landmarker(assets, landmarks));
    }
  }
  if (views.empty()) {
    throw Error(ErrorKind::Usage,
                "no camera of the rig is marked as colour = true: one at least must see the face's texture");
  }
}

/// Looks for a face and fits the template to it. Returns why there is no mesh; empty where there is one.
std::string PerformanceTracker::Impl::place(const FrameSet& set, std::span<const capture::DepthMap> maps,
                                            mesh::MeshFrame& out) {
  const Clock::time_point begun = Clock::now();
  std::vector<SeenLandmarks> seen;
  std::vector<const track::LandmarkResult*> results;
  for (View& view : views) {
    const track::LandmarkResult& result = view.landmarker.process(picture(set, view));
    if (result.found) {
      seen.push_back({&view.camera->lens, &result.face});
    }
    if (result.found && &view == &views.front()) {
      for (Eigen::Index i = 0; i < result.face.points_px.cols(); ++i) {
        out.landmarks_px.emplace_back(result.face.points_px.col(i).head<2>());
      }
    }
  }
  out.stage_ms.landmarks_ms = ms_since(begun);
  if (seen.empty()) {
    return "no face in the colour cameras' pictures";
  }
  const std::vector<fit::Correspondence> correspondences = landmarks_in_space(seen, maps, model->landmarks);
  if (correspondences.size() < kLeastLandmarks) {
    return fmt::format(
        "a face is seen, but only {} of its landmarks have a depth (at least {} must): are the projectors "
        "on, "
        "and is it within the depths that are looked at?",
        correspondences.size(), kLeastLandmarks);
  }
  fit::Placement placed;
  try {
    placed = fit::place(*surface, control_mm, correspondences);
  } catch (const Error& error) {
    return error.what();
  }
  fit::FitOptions first_options = options;
  first_options.steps = kPlacingSteps;
  first_options.cg_iterations = kPlacingCgIterations;
  fit::TemplateFitter first(surface, first_options);
  first.set_rest(placed.rest);
  mesh::Vertices fitted_mm = placed.rest.vertices_mm;
  const fit::FitReport report = first.fit(maps, fitted_mm);
  const bool fits =
      report.outcome == fit::FitOutcome::Converged || report.outcome == fit::FitOutcome::NotConverged;
  if (!fits || report.surface_rms_mm > kPlacedRms_mm || report.seen < kPlacedSeen) {
    return fmt::format(
        "the template does not fit the depth maps: {}, {:.1f} mm away, {:.0f} % of the skin on them",
        fit::to_string(report.outcome), report.surface_rms_mm, 100 * report.seen);
  }
  now_mm = std::move(fitted_mm);
  fitter.set_rest({now_mm, placed.rest.expressions_mm});
  const Eigen::Isometry3d head_from_rig =
      fit::align_rigidly(now_mm.cast<double>(), surface->neutral_mm.cast<double>(), rigid_weights);
  rest_mm = head_from_rig * now_mm.cast<double>();
  subject = build_template_subject(*surface, fine.hierarchy(), *model, ++subject_count);
  texture.begin(fine.hierarchy()->finest().vertex_count);
  displacements_mm.clear();
  mesh::vertex_normals(now_mm, surface->triangles, normals);
  for (View& view : views) {
    view.reference.reset();
    const Frame& frame = picture(set, view);
    const capture::Lens& lens = view.camera->lens;
    if (!frame.empty() && !frame.corrupt) {
      fit::find_visible(lens, now_mm, normals, surface->triangles, kVisibleMargin_mm, 0, visible);
      view.reference.emplace(lens, frame, now_mm, surface->triangles, visible);
    }
  }
  return {};
}

/// Flow from the slot before, then from the first picture's skin drawn where the mesh is (against drift).
fit::FitReport PerformanceTracker::Impl::follow_flow(const FrameSet& set,
                                                     std::span<const capture::DepthMap> maps) {
  std::vector<fit::FlowView> flows;
  const auto add = [&](View& view) {
    flows.push_back({view.camera->lens, view.found.width_px, view.found.height_px, view.found.flow_px,
                     view.found.confidence});
  };
  for (View& view : views) {
    const Frame& frame = picture(set, view);
    if (!frame.empty() && !frame.corrupt && !view.before.empty()) {
      view.flow.find(view.before, frame, view.found);
      add(view);
    }
  }
  const mesh::Vertices before_mm = now_mm;
  fit::FitReport report = fitter.track(maps, flows, before_mm, now_mm);
  flows.clear();
  mesh::vertex_normals(now_mm, surface->triangles, normals);
  for (View& view : views) {
    const Frame& frame = picture(set, view);
    if (frame.empty() || frame.corrupt || !view.reference) {
      continue;
    }
    fit::find_visible(view.camera->lens, now_mm, normals, surface->triangles, kVisibleMargin_mm, 0, visible);
    const Frame expected = view.reference->draw(frame, now_mm, visible, drawn);
    view.flow.find(expected, frame, view.found);
    for (std::size_t i = 0; i < drawn.size(); ++i) {
      view.found.confidence[i] *= static_cast<float>(drawn[i]);
    }
    add(view);
  }
  if (flows.empty()) {
    return report;
  }
  const mesh::Vertices drifted_mm = now_mm;
  return fitter.track(maps, flows, drifted_mm, now_mm);
}

/// Returns why there is no mesh in this slot; empty where there is one.
std::string PerformanceTracker::Impl::follow(const FrameSet& set, std::span<const capture::DepthMap> maps) {
  const mesh::Vertices before_mm = now_mm;
  const fit::FitReport report = follow_flow(set, maps);
  const bool fits =
      report.outcome == fit::FitOutcome::Converged || report.outcome == fit::FitOutcome::NotConverged;
  if (fits && report.surface_rms_mm <= kFollowedRms_mm && report.seen >= kFollowedSeen) {
    return {};
  }
  now_mm = before_mm;
  return fmt::format("the face is lost: {}, {:.1f} mm from the depth maps, {:.0f} % of the skin on them",
                     fit::to_string(report.outcome), report.surface_rms_mm, 100 * report.seen);
}

/// The fine levels, and the texture on them.
void PerformanceTracker::Impl::refine(const FrameSet& set, std::span<const capture::DepthMap> maps,
                                      mesh::MeshFrame& out) {
  Clock::time_point begun = Clock::now();
  fine.fit(maps, now_mm, displacements_mm, confidence);
  out.displacements_mm.assign(displacements_mm.begin(), displacements_mm.end());
  out.confidence.assign(confidence.begin(), confidence.end());
  out.stage_ms.displacement_ms = ms_since(begun);
  begun = Clock::now();
  const mesh::Hierarchy& hierarchy = *fine.hierarchy();
  mesh::rebuild_finest(hierarchy, now_mm, displacements_mm, fine_mm, fine_normals);
  for (const View& view : views) {
    texture.add(view.camera->lens, picture(set, view), fine_mm, fine_normals, hierarchy.finest().triangles);
  }
  texture.publish();
  out.stage_ms.albedo_ms = ms_since(begun);
}

/// What the next slot's flow begins with.
void PerformanceTracker::Impl::remember(const FrameSet& set) {
  for (View& view : views) {
    const Frame& frame = picture(set, view);
    view.before = frame.corrupt ? Frame() : frame;
  }
}

void PerformanceTracker::Impl::forget_pictures() {
  for (View& view : views) {
    view.before = {};
  }
}

void PerformanceTracker::Impl::fill(mesh::MeshFrame& out) {
  const View& view = views.front();
  const Eigen::Isometry3d rig_from_head = fit::align_rigidly(rest_mm, now_mm.cast<double>(), rigid_weights);
  out.subject = subject;
  out.camera = intrinsics_of(view.camera->lens);
  out.camera_from_head = (view.camera->lens.camera_from_rig * rig_from_head).cast<float>();
  out.control_vertices_mm = (rig_from_head.inverse() * now_mm.cast<double>()).cast<float>();
  out.expression.assign(model->expression_names.size(), 0.0F);
  const Eigen::VectorXd& expression = fitter.expression();
  for (Eigen::Index e = 0; e < std::min<Eigen::Index>(expression.size(), std::ssize(out.expression)); ++e) {
    out.expression[static_cast<std::size_t>(e)] = static_cast<float>(std::clamp(expression[e], 0.0, 1.0));
  }
  out.albedo = texture.latest();
}

PerformanceTracker::PerformanceTracker(std::shared_ptr<const face::FaceModel> model,
                                       const std::filesystem::path& landmark_assets,
                                       std::shared_ptr<const capture::Rig> rig,
                                       const fit::FitOptions& options)
    : impl_(std::make_unique<Impl>(std::move(model), landmark_assets, std::move(rig), options)) {}

PerformanceTracker::~PerformanceTracker() = default;

void PerformanceTracker::process(const FrameSet& set, std::span<const capture::DepthMap> maps,
                                 mesh::MeshFrame& out) {
  Impl& impl = *impl_;
  out.camera = intrinsics_of(impl.views.front().camera->lens);
  out.control_vertices_mm.resize(3, 0);
  const bool followed = impl.subject != nullptr && impl.gaps < kMostGaps;
  Clock::time_point begun = Clock::now();
  const std::string missing = followed ? impl.follow(set, maps) : impl.place(set, maps, out);
  out.stage_ms.fit_ms = ms_since(begun) - out.stage_ms.landmarks_ms;
  if (missing.empty()) {
    impl.gaps = 0;
    out.state = mesh::TrackingState::Tracking;
    impl.refine(set, maps, out);
    impl.fill(out);
    impl.remember(set);
  } else {
    ++impl.gaps;
    impl.forget_pictures();  // the flow from the last mesh's picture would be too long to follow
    out.state = impl.subject != nullptr ? mesh::TrackingState::Lost : mesh::TrackingState::Searching;
    out.degraded = true;
    out.degraded_reason = out.degraded_reason.empty() ? missing : out.degraded_reason + "; " + missing;
  }
}

void PerformanceTracker::reset() {
  impl_->subject.reset();
  impl_->gaps = 0;
  impl_->forget_pictures();
  for (View& view : impl_->views) {
    view.landmarker.forget();
  }
}

const mesh::Vertices* PerformanceTracker::vertices_mm() const {
  return impl_->subject != nullptr ? &impl_->now_mm : nullptr;
}

}  // namespace facet::pipeline
