#include "track/tracker.hpp"

#include <algorithm>
#include <chrono>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "landmark/landmarker.hpp"
#include "track/depth_filter.hpp"
#include "track/expression_prior.hpp"
#include "track/expression_reader.hpp"
#include "track/landmark_model.hpp"
#include "track/subject_tracker.hpp"

namespace facet::track {
namespace {

ExpressionPriorStrength prior_strength(const TrackerConfig& config) {
  ExpressionPriorStrength strength;
  const auto scale = static_cast<double>(config.expression_prior);
  strength.size *= scale;
  strength.sparsity *= scale;
  strength.symmetry *= scale;
  strength.exclusion *= scale;
  return strength;
}

/// Good frames over which the focal length, and how its landmarks lie, are estimated of a live head whose
/// shape is known.
constexpr int kKnownFrames = 3;

SubjectTrackerConfig subject_config(const TrackerConfig& config, const face::FaceModel& model) {
  SubjectTrackerConfig result;
  // Whose shape is known needs to be found, not to be guessed.
  const bool at_once = config.live && model.identity_count() == 0;
  result.acquisition_frames =
      at_once ? std::min(config.acquisition_frames, kKnownFrames) : config.acquisition_frames;
  result.intrinsics = config.intrinsics;
  result.further_views = config.further_views;
  result.shading_model = config.identity_shading && !at_once ? &model : nullptr;
  result.temporal.strength *= static_cast<double>(config.temporal_prior);
  return result;
}

// Frames this far apart tell nothing of a speed.
constexpr double kLongestGap_s = 0.5;
constexpr double kShortestFrame_s = 1e-3;

std::vector<CameraIntrinsics> lenses_of(const TrackerConfig& config) {
  if (config.further_views.empty()) {
    return {CameraIntrinsics{}};
  }
  if (!config.intrinsics) {
    throw Error(ErrorKind::Usage, "several views are tracked with a calibrated reference camera alone");
  }
  std::vector<CameraIntrinsics> lenses{*config.intrinsics};
  for (const FurtherCamera& view : config.further_views) {
    lenses.push_back(view.intrinsics);
  }
  return lenses;
}

bool has_size_of(const Frame& frame, const CameraIntrinsics& lens) {
  return frame.width_px == lens.width_px && frame.height_px == lens.height_px;
}

/// Of the first view that has a picture.
std::int64_t time_of(std::span<const Frame> views) {
  const auto there =
      std::find_if(views.begin(), views.end(), [](const Frame& frame) { return !frame.empty(); });
  return there == views.end() ? views.front().media_time_ns : there->media_time_ns;
}

}  // namespace

struct Tracker::Impl {
  Impl(const face::FaceModel& face_model, const TrackerConfig& config)
      : model(face_model),
        lenses(lenses_of(config)),
        view_landmarks(lenses.size()),
        landmark_model(face_model),
        prior(face_model.expression_names, face_model.expression_sigma, prior_strength(config),
              landmark_model.sees_gaze()),
        subject_tracker(landmark_model, prior, subject_config(config, face_model)),
        reader(landmark_model, face_model.expression_names, learned_reading()) {
    result.identity.resize(static_cast<std::size_t>(face_model.identity_count()));
    result.expression.resize(static_cast<std::size_t>(face_model.expression_count()));
    result.values.resize(result.expression.size());
    result.value_confidence.reserve(result.expression.size());
    result.vertices_mm.setZero(3, face_model.vertex_count());
    result.landmarks_px.reserve(landmark::landmark_count);
    for (std::size_t v = 0; v < lenses.size(); ++v) {
      landmarkers.emplace_back(config.landmark_nets, landmark::LandmarkerConfig{.live = config.live});
    }
  }

  /// Looks at all views and fits what they show; face: becomes the reference camera's, null where it has
  /// none.
  const SubjectFrame& follow(std::span<const Frame> views, const landmark::FaceLandmarks*& face) {
    for (std::size_t v = 0; v < lenses.size(); ++v) {
      const bool fits = v < views.size() && (lenses.size() == 1 || has_size_of(views[v], lenses[v]));
      const landmark::LandmarkResult& landmarks = landmarkers[v].process(fits ? views[v] : Frame{});
      view_landmarks[v] = {landmarks.found ? &landmarks.face : nullptr, landmarks.acquired};
      result.detect_ms += landmarks.detect_ms;
      result.landmarks_ms += landmarks.landmarks_ms;
    }
    face = view_landmarks.front().face;
    const Clock::time_point start = Clock::now();
    const bool one = lenses.size() == 1;
    const SubjectFrame& subject = subject_tracker.process(
        view_landmarks, one ? views.front().width_px : lenses.front().width_px,
        one ? views.front().height_px : lenses.front().height_px, time_of(views), &views.front());
    result.fit_ms += ms_since(start);
    return subject;
  }

  void take_mesh(const SubjectFrame& subject, std::int64_t time_ns) {
    const Clock::time_point start = Clock::now();
    if (subject.shape_version != shape_version) {
      shape_version = subject.shape_version;
      depth_filter.reset();  // another shape or focal length stands at another distance
      const Eigen::VectorXd& identity = subject_tracker.shape().identity;
      std::copy(identity.begin(), identity.end(), result.identity.begin());
      basis = model.contract_identity(result.identity);
    }
    std::copy(subject.face.expression.begin(), subject.face.expression.end(), result.expression.begin());
    basis.evaluate(result.expression, result.vertices_mm);
    read_values(subject);
    result.camera_from_head.linear() = subject.face.pose.rotation.cast<float>();
    result.camera_from_head.translation() = calmed(subject.face.pose.translation_mm, time_ns).cast<float>();
    result.reprojection_px = static_cast<float>(subject.reprojection_px);
    result.fit_ms += ms_since(start);
  }

  /// From the reference camera, or where that one shows no face the first one that does.
  void read_values(const SubjectFrame& subject) {
    std::copy(result.expression.begin(), result.expression.end(), result.values.begin());
    result.value_confidence.clear();
    const auto used = std::find(subject.view_used.begin(), subject.view_used.end(), 1);
    if (used == subject.view_used.end()) {
      return;
    }
    const auto view = static_cast<std::size_t>(used - subject.view_used.begin());
    landmark_movements(landmark_model, subject_tracker.basis(), *view_landmarks[view].face,
                       subject_tracker.camera_of(view), subject_tracker.shape().focal_px, subject.face,
                       result.movements);
    if (subject.subject != read_subject) {
      read_subject = subject.subject;
      reader.forget();
    }
    reader.read(result.movements, result.values, result.value_confidence);
  }

  /// The head's place with its distance filtered, along the ray on which it is seen.
  Eigen::Vector3d calmed(const Eigen::Vector3d& place_mm, std::int64_t time_ns) {
    const double seconds = static_cast<double>(time_ns - filtered_ns) * 1e-9;
    filtered_ns = time_ns;
    if (lenses.size() > 1) {
      return place_mm;  // rays from several sides measure it as well as the rest of the place
    }
    if (!(seconds > 0 && seconds < kLongestGap_s)) {
      depth_filter.reset();
    }
    return place_mm * (depth_filter.apply(place_mm.z(), std::max(seconds, kShortestFrame_s)) / place_mm.z());
  }

  TrackResult result;
  const face::FaceModel& model;
  face::ExpressionBasis basis;
  std::uint64_t shape_version = 0;
  DepthFilter depth_filter;
  std::int64_t filtered_ns = 0;
  std::vector<CameraIntrinsics> lenses;           ///< [view] calibrated; of one camera alone all 0
  std::vector<landmark::Landmarker> landmarkers;  ///< [view]
  std::vector<ViewLandmarks> view_landmarks;
  LandmarkModel landmark_model;
  ExpressionPrior prior;
  SubjectTracker subject_tracker;
  ExpressionReader reader;
  std::uint32_t read_subject = 0;  ///< whose values the reader has seen
};

Tracker::Tracker(const face::FaceModel& model, const TrackerConfig& config)
    : impl_(std::make_unique<Impl>(model, config)) {}

Tracker::~Tracker() = default;

const TrackResult& Tracker::process(const Frame& frame) {
  return process({&frame, 1});
}

const TrackResult& Tracker::process(std::span<const Frame> views) {
  TrackResult& result = impl_->result;
  result.detect_ms = 0;
  result.landmarks_ms = 0;
  result.fit_ms = 0;
  const bool was_good = result.has_mesh;
  const landmark::FaceLandmarks* face = nullptr;
  const SubjectFrame* subject = &impl_->follow(views, face);
  for (std::size_t v = 0; v < impl_->landmarkers.size(); ++v) {
    if (subject->view_rejected[v] != 0) {
      impl_->landmarkers[v].forget();
    }
  }
  if (subject->rejected && was_good) {
    // The landmarks slipped off a face that was there a frame ago: look again at once.
    subject = &impl_->follow(views, face);
  }
  result.state = subject->state;
  result.subject = subject->subject;
  result.has_mesh = subject->fitted;
  result.view_used.assign(subject->view_used.begin(), subject->view_used.end());
  result.camera = impl_->subject_tracker.camera();
  result.landmarks_px.clear();
  result.interocular_px = 0;
  if (face != nullptr) {
    const auto& points = face->points_px;
    for (Eigen::Index i = 0; i < points.cols(); ++i) {
      result.landmarks_px.emplace_back(points.col(i).head<2>());
    }
    result.interocular_px = face->interocular_px;
  }
  if (subject->fitted) {
    impl_->take_mesh(*subject, time_of(views));
  } else {
    impl_->depth_filter.reset();
  }
  return result;
}

void Tracker::reset_identity() {
  impl_->subject_tracker.reset_identity();
}

std::uint32_t Tracker::subjects() const {
  return impl_->result.subject;
}

std::optional<Person> Tracker::person() const {
  const SubjectTracker& tracker = impl_->subject_tracker;
  return tracker.has_person() ? std::optional<Person>(tracker.person()) : std::nullopt;
}

bool Tracker::settle_subject() {
  return impl_->subject_tracker.settle();
}

void Tracker::adopt(const Person& person, int width_px, int height_px) {
  if (!impl_->subject_tracker.adopt(person, width_px, height_px)) {
    throw Error(
        ErrorKind::Usage,
        "the subject to be tracked was estimated with another face model: let the tracker estimate it anew");
  }
}

}  // namespace facet::track
