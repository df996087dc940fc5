#include "booth/performance_tracker.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <list>
#include <optional>
#include <utility>
#include <vector>

#include "booth/face_in_space.hpp"
#include "booth/template_subject.hpp"
#include "booth/vertex_texture.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "fit/fine_surface.hpp"
#include "fit/first_shape.hpp"
#include "fit/skin_tracker.hpp"
#include "fit/template_mesh.hpp"
#include "render/embree.hpp"

namespace facet::booth {
namespace {

constexpr std::size_t kLeastLandmarks = 60;
constexpr std::size_t kLeastPoints = 8;  ///< that a person pointed at
/// Slots in a row in which a face is seen, placed and not found to be the person of before: another one.
constexpr int kStrangerSlots = 3;

/// A camera that sees texture.
struct View {
  View(const capture::Rig& rig, std::size_t given_index, landmark::Landmarker given_landmarker)
      : camera(&rig.cameras[given_index]), index(given_index), landmarker(std::move(given_landmarker)) {}

  const capture::RigCamera* camera;
  std::size_t index;  ///< in the rig
  landmark::Landmarker landmarker;
};

std::vector<capture::Lens> projector_lenses(const capture::Rig& rig) {
  std::vector<capture::Lens> lenses;
  for (const capture::RigProjector& projector : rig.projectors) {
    lenses.push_back(projector.lens);
  }
  return lenses;
}

std::vector<capture::Lens> colour_lenses(const capture::Rig& rig) {
  std::vector<capture::Lens> lenses;
  for (const capture::RigCamera& camera : rig.cameras) {
    if (camera.colour) {
      lenses.push_back(camera.lens);
    }
  }
  return lenses;
}

void degrade(const std::string& reason, mesh::MeshFrame& out) {
  out.degraded = true;
  out.degraded_reason += (out.degraded_reason.empty() ? "" : "; ") + reason;
}

}  // namespace

struct PerformanceTracker::Impl {
  Impl(std::shared_ptr<const face::FaceModel> given_model, const std::filesystem::path& assets,
       std::shared_ptr<const capture::Rig> given_rig, const fit::SkinTrackerOptions& given_options,
       std::optional<FacePoints> given_points, std::unique_ptr<BoothShading> given_shading);

  std::shared_ptr<const face::FaceModel> model;
  std::shared_ptr<const capture::Rig> rig;
  std::shared_ptr<const fit::TemplateMesh> surface;
  fit::SkinTracker skin;
  fit::FineSurface fine;
  Eigen::VectorXd rigid_weights;  ///< [vertex_count] 1 on skin that expressions hardly move
  std::list<View> views;          ///< colour cameras

  std::optional<FacePoints> points;
  std::unique_ptr<BoothShading> shading;  ///< null: none
  PhotometricStereo photometric;
  mesh::Vertices before_mm;  ///< [3][vertex_count] of the blank slot before, where it was followed from there
  std::shared_ptr<const mesh::Subject> subject;  ///< null: nobody is followed
  std::uint32_t subject_count = 0;
  Eigen::Matrix3Xd rest_mm;             ///< [3][vertex_count] the person in the first slot, head frame
  bool begun_torn = false;              ///< what landmarks made of the first slot, that rest_mm came from
  bool torn = false;                    ///< the last slot's mesh
  bool lost = false;                    ///< the last slot had no mesh
  int strangers = 0;                    ///< slots in a row in which somebody else is seen
  std::vector<float> displacements_mm;  ///< [finest vertex_count] by depth
  std::vector<float> shading_mm;        ///< [finest vertex_count] what the last blank slot's shading adds
  std::vector<float> confidence;
  mesh::Vertices between_mm;  ///< of the last slot between
  Eigen::VectorXd expression_between;
  VertexTexture texture;
  mesh::Vertices fine_mm;  ///< [3][finest vertex_count] rig frame
  Eigen::Matrix3Xf fine_normals;

  std::vector<Frame> pictures;  ///< [views] of the slot

  void take_pictures(const FrameSet& set);
  void forget_landmarks();
  std::vector<SeenLandmarks> find_landmarks(mesh::MeshFrame& out);
  std::vector<SeenLandmarks> pointed_at() const;
  std::string place(std::uint64_t slot, std::span<const capture::DepthMap> maps, mesh::MeshFrame& out);
  fit::TemplateFitReport begin(const fit::Placement& by_landmarks,
                               std::span<const fit::Correspondence> correspondences,
                               std::span<const capture::DepthMap> maps, bool& deceived);
  std::string follow(std::span<const capture::DepthMap> maps);
  void begin_subject();
  void fit_fine(std::span<const capture::DepthMap> maps, const mesh::Vertices& vertices_mm);
  void shade(const FrameSet& set, std::span<const LitSlot> lit, bool followed, mesh::MeshFrame& out);
  void fill_fine(const mesh::Vertices& vertices_mm, mesh::MeshFrame& out);
  void paint(mesh::MeshFrame& out);
  void fill(const mesh::Vertices& vertices_mm, const Eigen::VectorXd& expression, mesh::MeshFrame& out);
  void leave_out(const std::string& missing, mesh::MeshFrame& out) const;
  void tell_torn(mesh::MeshFrame& out) const;
};

PerformanceTracker::Impl::Impl(std::shared_ptr<const face::FaceModel> given_model,
                               const std::filesystem::path& assets,
                               std::shared_ptr<const capture::Rig> given_rig,
                               const fit::SkinTrackerOptions& given_options,
                               std::optional<FacePoints> given_points,
                               std::unique_ptr<BoothShading> given_shading)
    : model(std::move(given_model)),
      rig(std::move(given_rig)),
      surface(std::make_shared<const fit::TemplateMesh>(fit::make_template(*model))),
      skin(surface, colour_lenses(*rig), projector_lenses(*rig), given_options),
      fine(model->control, surface),
      points(std::move(given_points)),
      shading(std::move(given_shading)),
      photometric(rig, {}) {
  render::require_embree();  // for landmarks in space
  mesh::Vertices control_mm;
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
  landmark::LandmarkerConfig landmarks;
  landmarks.smooth = false;
  for (std::size_t i = 0; i < rig->cameras.size(); ++i) {
    if (rig->cameras[i].colour) {
      views.emplace_back(*rig, i, landmark::Landmarker(assets, landmarks));
    }
  }
  if (views.empty()) {
    throw Error(ErrorKind::Usage,
                "no camera of the rig is marked as colour = true: one at least must see the face's texture");
  }
  for (const FacePoints::Camera& camera : points ? points->cameras : std::vector<FacePoints::Camera>()) {
    if (!capture::find_camera(*rig, camera.name)) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("the face points are of a camera '{}', which the rig does not have", camera.name));
    }
  }
}

void PerformanceTracker::Impl::take_pictures(const FrameSet& set) {
  pictures.clear();
  for (const View& view : views) {
    pictures.push_back(set.frames.at(view.index));
  }
}

void PerformanceTracker::Impl::forget_landmarks() {
  for (View& view : views) {
    view.landmarker.forget();
  }
}

std::vector<SeenLandmarks> PerformanceTracker::Impl::find_landmarks(mesh::MeshFrame& out) {
  const Clock::time_point begun = Clock::now();
  std::vector<SeenLandmarks> seen;
  std::size_t at = 0;
  for (View& view : views) {
    const landmark::LandmarkResult& result = view.landmarker.process(pictures[at++]);
    if (result.found) {
      seen.push_back({&view.camera->lens, &result.face, false});
    }
    if (result.found && &view == &views.front()) {
      for (Eigen::Index i = 0; i < result.face.points_px.cols(); ++i) {
        out.landmarks_px.emplace_back(result.face.points_px.col(i).head<2>());
      }
    }
  }
  out.stage_ms.landmarks_ms = ms_since(begun);
  return seen;
}

std::vector<SeenLandmarks> PerformanceTracker::Impl::pointed_at() const {
  std::vector<SeenLandmarks> seen;
  for (const FacePoints::Camera& camera : points->cameras) {
    const std::size_t at = capture::find_camera(*rig, camera.name).value();  // looked for at the start
    seen.push_back({&rig->cameras[at].lens, &camera.face, true});
  }
  return seen;
}

/// Looks for a face: the person of before, or a new one. Returns why there is no mesh; empty where there is
/// one.
std::string PerformanceTracker::Impl::place(std::uint64_t slot, std::span<const capture::DepthMap> maps,
                                            mesh::MeshFrame& out) {
  if (points && slot < points->slot) {
    return fmt::format("the face is pointed at in slot {}", points->slot);
  }
  const bool pointed = points && slot == points->slot;
  const std::vector<SeenLandmarks> seen = pointed ? pointed_at() : find_landmarks(out);
  if (seen.empty()) {
    return "no face in the colour cameras' pictures";
  }
  const std::vector<fit::Correspondence> correspondences = landmarks_in_space(seen, maps, model->landmarks);
  const std::size_t least = pointed ? kLeastPoints : kLeastLandmarks;
  if (correspondences.size() < least) {
    return fmt::format(
        "a face is seen, but only {} of its landmarks have a depth (at least {} must): are the projectors "
        "on, "
        "and is it within the depths that are looked at?",
        correspondences.size(), least);
  }
  fit::Placement placed;
  try {
    placed = fit::place(*surface, fit::find_first_shape(*model, correspondences), correspondences);
  } catch (const Error& error) {
    return error.what();
  }
  if (subject != nullptr) {
    const fit::TemplateFitReport report = skin.find_again(placed, maps, pictures);
    torn = report.torn();
    if (!report.lost) {
      return {};
    }
    if (++strangers < kStrangerSlots) {
      return fmt::format("a face is seen that is not the one of before: {}", report.lost_because);
    }
  }
  bool deceived = false;
  const fit::TemplateFitReport report = begin(placed, correspondences, maps, deceived);
  if (report.lost) {
    return fmt::format(
        "the template does not fit the depth maps: {}; are the projectors on, and is nothing before the "
        "face?",
        report.lost_because);
  }
  begin_subject();
  begun_torn = deceived;
  torn = report.torn();
  return {};
}

/// Fits the template to somebody new. A mouth that is wide open deceives the landmark net: where the mesh is
/// torn by what it says, others are made of wider jaws and the landmarks above them, and the one that tears
/// least is taken; better, and still not to be trusted. deceived: out, whether the landmarks tore it
fit::TemplateFitReport PerformanceTracker::Impl::begin(const fit::Placement& by_landmarks,
                                                       std::span<const fit::Correspondence> correspondences,
                                                       std::span<const capture::DepthMap> maps,
                                                       bool& deceived) {
  constexpr std::array kWiderJaws{0.75, 1.0, 1.25};
  fit::TemplateFitReport report = skin.start(by_landmarks, maps, pictures);
  deceived = report.torn();
  if (report.lost || !deceived) {
    return report;
  }
  const std::vector<fit::Correspondence> above = fit::above_the_jaw(*model, correspondences);
  if (above.size() == correspondences.size()) {
    return report;  // a model without a jaw
  }
  fit::Placement best = by_landmarks;
  double least = report.tear();
  bool is_last = true;
  for (const double jaw : kWiderJaws) {
    fit::Placement placed;
    try {
      placed = fit::place(*surface, fit::find_first_shape(*model, above, jaw), above);
    } catch (const Error&) {
      break;  // too few are above the jaw
    }
    const fit::TemplateFitReport found = skin.start(placed, maps, pictures);
    is_last = !found.lost && found.tear() < least;
    if (is_last) {
      least = found.tear();
      best = std::move(placed);
      report = found;
    }
  }
  return is_last ? report : skin.start(best, maps, pictures);
}

void PerformanceTracker::Impl::begin_subject() {
  const mesh::Vertices& now_mm = skin.vertices_mm();
  const Eigen::Isometry3d head_from_rig =
      fit::align_rigidly(now_mm.cast<double>(), surface->neutral_mm.cast<double>(), rigid_weights);
  rest_mm = head_from_rig * now_mm.cast<double>();
  subject = build_template_subject(*surface, fine.hierarchy(), *model, ++subject_count);
  texture.begin(fine.hierarchy()->finest().vertex_count);
  displacements_mm.clear();
  shading_mm.clear();
  if (shading != nullptr) {
    shading->begin(*fine.hierarchy(), *surface, *model);
  }
  photometric.begin(fine.hierarchy(), *surface);
}

/// Returns why there is no mesh in this slot; empty where there is one.
std::string PerformanceTracker::Impl::follow(std::span<const capture::DepthMap> maps) {
  const fit::TemplateFitReport report = skin.follow(maps, pictures);
  torn = report.torn();
  return report.lost ? "the face is lost: " + report.lost_because : std::string();
}

/// The fine levels of a slot's mesh, from those of the mesh made last.
void PerformanceTracker::Impl::fit_fine(std::span<const capture::DepthMap> maps,
                                        const mesh::Vertices& vertices_mm) {
  fine.fit(maps, vertices_mm, displacements_mm, confidence);
}

/// What the blank slot's pictures add to them.
void PerformanceTracker::Impl::shade(const FrameSet& set, std::span<const LitSlot> lit, bool followed,
                                     mesh::MeshFrame& out) {
  std::string missing;
  if (!lit.empty() && followed) {
    missing = photometric.refine(set, lit, before_mm, skin.vertices_mm(), displacements_mm, shading_mm);
  } else if (shading != nullptr) {
    missing = shading->refine(pictures, skin.vertices_mm(), displacements_mm, shading_mm);
  } else {
    shading_mm.clear();
  }
  if (!missing.empty()) {
    degrade(missing, out);
  }
}

void PerformanceTracker::Impl::tell_torn(mesh::MeshFrame& out) const {
  if (begun_torn) {
    degrade(
        "the mesh can't be trusted about the mouth, which was too wide open in its first slot: begin anew "
        "with the mouth closer shut",
        out);
  } else if (torn) {
    degrade("the mesh is torn about the mouth", out);
  }
}

void PerformanceTracker::Impl::fill_fine(const mesh::Vertices& vertices_mm, mesh::MeshFrame& out) {
  if (shading_mm.empty()) {
    out.displacements_mm.assign(displacements_mm.begin(), displacements_mm.end());
  } else {
    fine.add(vertices_mm, displacements_mm, shading_mm, out.displacements_mm);
  }
  out.confidence.assign(confidence.begin(), confidence.end());
}

/// The texture of the blank slot's mesh.
void PerformanceTracker::Impl::paint(mesh::MeshFrame& out) {
  const Clock::time_point begun = Clock::now();
  const mesh::Hierarchy& hierarchy = *fine.hierarchy();
  mesh::rebuild_finest(hierarchy, skin.vertices_mm(), out.displacements_mm, fine_mm, fine_normals);
  std::size_t at = 0;
  for (const View& view : views) {
    texture.add(view.camera->lens, pictures[at++], fine_mm, fine_normals, hierarchy.finest().triangles);
  }
  texture.publish();
  out.stage_ms.albedo_ms = ms_since(begun);
}

void PerformanceTracker::Impl::fill(const mesh::Vertices& vertices_mm, const Eigen::VectorXd& expression,
                                    mesh::MeshFrame& out) {
  const View& view = views.front();
  const Eigen::Isometry3d rig_from_head =
      fit::align_rigidly(rest_mm, vertices_mm.cast<double>(), rigid_weights);
  out.state = mesh::TrackingState::Tracking;
  out.subject = subject;
  out.camera = capture::pinhole_of(view.camera->lens);
  out.camera_from_head = (view.camera->lens.camera_from_rig * rig_from_head).cast<float>();
  out.control_vertices_mm = (rig_from_head.inverse() * vertices_mm.cast<double>()).cast<float>();
  out.expression.assign(model->expression_names.size(), 0.0F);
  for (Eigen::Index e = 0; e < std::min<Eigen::Index>(expression.size(), std::ssize(out.expression)); ++e) {
    out.expression[static_cast<std::size_t>(e)] = static_cast<float>(std::clamp(expression[e], 0.0, 1.0));
  }
  out.albedo = texture.latest();
}

/// No mesh of this slot, and why.
void PerformanceTracker::Impl::leave_out(const std::string& missing, mesh::MeshFrame& out) const {
  out.state = subject != nullptr ? mesh::TrackingState::Lost : mesh::TrackingState::Searching;
  degrade(missing, out);
}

PerformanceTracker::PerformanceTracker(std::shared_ptr<const face::FaceModel> model,
                                       const std::filesystem::path& landmark_nets,
                                       std::shared_ptr<const capture::Rig> rig,
                                       const fit::SkinTrackerOptions& options,
                                       std::optional<FacePoints> points,
                                       std::unique_ptr<BoothShading> shading)
    : impl_(std::make_unique<Impl>(std::move(model), landmark_nets, std::move(rig), options,
                                   std::move(points), std::move(shading))) {}

PerformanceTracker::~PerformanceTracker() = default;

std::optional<double> PerformanceTracker::strain(const FrameSet& set,
                                                 std::span<const capture::DepthMap> maps) {
  Impl& impl = *impl_;
  if (impl.points) {
    return {};
  }
  impl.take_pictures(set);
  mesh::MeshFrame unused;
  const std::vector<SeenLandmarks> seen = impl.find_landmarks(unused);
  impl.forget_landmarks();
  const std::vector<fit::Correspondence> correspondences =
      landmarks_in_space(seen, maps, impl.model->landmarks);
  if (correspondences.size() < kLeastLandmarks) {
    return {};
  }
  try {
    return fit::find_first_shape(*impl.model, correspondences).expression.norm();
  } catch (const Error&) {
    return {};  // `process` says so, where this slot is the one to begin with
  }
}

void PerformanceTracker::process(const FrameSet& set, std::span<const capture::DepthMap> maps,
                                 mesh::MeshFrame& out, std::span<const LitSlot> lit) {
  Impl& impl = *impl_;
  out.camera = capture::pinhole_of(impl.views.front().camera->lens);
  out.control_vertices_mm.resize(3, 0);
  impl.take_pictures(set);
  if (impl.subject != nullptr) {
    impl.before_mm = impl.skin.vertices_mm();
  }
  const Clock::time_point begun = Clock::now();
  std::string missing;
  bool followed = impl.subject != nullptr && !impl.lost;
  if (followed) {
    missing = impl.follow(maps);
    followed = missing.empty();
  }
  if (!followed) {
    // Landmarks tell where the face is now, or that there is none.
    const std::string unplaced = impl.place(set.slot, maps, out);
    missing = missing.empty() || unplaced.empty() ? unplaced : missing + "; " + unplaced;
  }
  out.stage_ms.fit_ms = ms_since(begun) - out.stage_ms.landmarks_ms;
  impl.lost = !missing.empty();
  if (missing.empty()) {
    impl.strangers = 0;
    const Clock::time_point fine_begun = Clock::now();
    if (!followed && impl.shading != nullptr) {
      impl.shading->restart();
    }
    impl.fit_fine(maps, impl.skin.vertices_mm());
    impl.shade(set, lit, followed, out);
    impl.fill_fine(impl.skin.vertices_mm(), out);
    out.stage_ms.displacement_ms = ms_since(fine_begun);
    impl.paint(out);
    impl.fill(impl.skin.vertices_mm(), impl.skin.expression(), out);
    impl.tell_torn(out);
  } else {
    impl.leave_out(missing, out);
  }
}

void PerformanceTracker::process_between(double fraction, std::span<const capture::DepthMap> maps,
                                         mesh::MeshFrame& out) {
  Impl& impl = *impl_;
  out.camera = capture::pinhole_of(impl.views.front().camera->lens);
  out.control_vertices_mm.resize(3, 0);
  const bool has_both = fraction > 0 && fraction < 1;
  if (!has_both || impl.subject == nullptr || impl.lost || !impl.skin.follows()) {
    impl.leave_out(has_both ? "one of the blank slots around it has no mesh" : "no blank slot comes after it",
                   out);
    return;
  }
  const Clock::time_point begun = Clock::now();
  const fit::TemplateFitReport report =
      impl.skin.between(fraction, maps, impl.between_mm, impl.expression_between);
  out.stage_ms.fit_ms = ms_since(begun);
  if (report.lost) {
    impl.leave_out(report.lost_because, out);
    return;
  }
  const Clock::time_point fine_begun = Clock::now();
  impl.fit_fine(maps, impl.between_mm);
  impl.fill_fine(impl.between_mm, out);
  out.stage_ms.displacement_ms = ms_since(fine_begun);
  impl.fill(impl.between_mm, impl.expression_between, out);
  impl.tell_torn(out);
}

void PerformanceTracker::reset() {
  impl_->subject.reset();
  impl_->lost = false;
  impl_->strangers = 0;
  impl_->forget_landmarks();
}

std::vector<Messages::Message> PerformanceTracker::take_messages() {
  return impl_->shading != nullptr ? impl_->shading->take_messages() : std::vector<Messages::Message>();
}

const mesh::Vertices* PerformanceTracker::vertices_mm() const {
  return impl_->subject != nullptr ? &impl_->skin.vertices_mm() : nullptr;
}

}  // namespace facet::booth
