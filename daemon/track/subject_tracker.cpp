#include "track/subject_tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "maths/statistics.hpp"

namespace facet::track {
namespace {

/// Levenberg-Marquardt steps of a frame that continues the last one, and of one that starts anew.
constexpr int kWarmIterations = 6;
constexpr int kColdIterations = 25;

/// Median residual beyond which a frame is not believed, as a fraction of the interocular distance: while the
/// identity is still the mean face, and once it is known.
constexpr double kLargestFirstResidual = 0.10;
constexpr double kLargestResidual = 0.06;
/// The same for what one view's fit foretells of another view: at a distance that it knows badly.
constexpr double kAgreeingResidual = 0.25;
/// A landmark counts in the median from this confidence on.
constexpr float kSeen = 0.5F;
/// Smaller faces than this have no expression to measure, px between the outer eye corners.
constexpr float kSmallestInterocularPx = 8.0F;
/// No coordinate of a landmark lies further from the image than this many image sizes.
constexpr float kFarthestOutside = 4.0F;
constexpr double kNearestHeadMm = 100.0;
constexpr double kFarthestHeadMm = 20'000.0;
/// Cosine of the largest angle between the face's axis and the line of sight (105 degrees).
constexpr double kFarthestTurn = -0.26;

/// On a head that is turned by more than this (25 degrees) the nets contradict each other where they no
/// longer see how far: a frame in which they do so more than the first limit has no mesh, nor have those
/// after it until they do so less than the second (FaceLandmarks::contradiction).
/// docs/decisions/turned-heads.md.
constexpr double kTurned = 0.906;
constexpr float kContradicted = 0.047F;
constexpr float kAgreed = 0.04F;

/// A head does not move faster: mm and rad per second, with a floor for short intervals.
constexpr double kFastestMmPerS = 2'500.0;
constexpr double kFastestRadPerS = 14.0;
constexpr double kShortestIntervalS = 0.04;

/// A gap up to this is bridged as if nothing had happened; after kLostForS the face counts as gone.
constexpr double kBriefGapS = 0.3;
constexpr double kLostForS = 1.0;

/// The batch takes a frame that differs this much from all it has, or after this many good frames anyway.
constexpr double kNewPoseRad = 0.07;
constexpr double kNewExpression = 0.3;
constexpr int kFramesBetweenLikeOnes = 4;
/// Batch sizes at which a provisional shape is solved, and the steps spent on it.
constexpr std::array kProvisionalAt = {1, 3, 8};
constexpr int kProvisionalIterations = 3;
/// Steps per frame once the batch is full, and frames after which the fit ends without having converged.
constexpr int kSettlingIterations = 1;
constexpr int kMostSettlingFrames = 20;
/// Gauss-Newton steps by the shading of the batch's pictures, and the steps by landmarks that follow each.
/// One step a frame: each takes as long as two or three pictures of a live camera.
constexpr int kShadingRounds = 6;
constexpr int kIterationsAfterShading = 2;
constexpr int kShadingSteps = kShadingRounds * (1 + kIterationsAfterShading);

/// A returned face is another person when its median residual over this many frames is larger than the
/// owner's by this factor and this difference (fraction of the interocular distance).
constexpr int kVerifyFrames = 10;
constexpr double kOtherPersonFactor = 1.6;
constexpr double kOtherPersonDifference = 0.004;
/// Good frames over which the usual residual is averaged.
constexpr int kResidualFrames = 100;

double seconds(std::int64_t nanoseconds) {
  return 1e-9 * static_cast<double>(nanoseconds);
}

double angle_between(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  return vector_from_rotation(a * b.transpose()).norm();
}

}  // namespace

SubjectTracker::SubjectTracker(const LandmarkModel& model, const ExpressionPrior& prior,
                               const SubjectTrackerConfig& config)
    : model_(&model),
      prior_(&prior),
      config_(config),
      coarse_fit_(model, prior, config.trust, config.temporal),
      start_head_mm_(3, model.count()),
      start_px_(3, model.count()),
      start_weights_(model.count()) {
  config_.acquisition_frames = std::max(config_.acquisition_frames, 1);
  candidate_.expression.setZero(model.expression_count());
  frame_.face = candidate_;
  previous_.previous = candidate_;
  views_.resize(1 + config_.further_views.size());
  observations_.resize(views_.size());
  agreeing_.resize(views_.size());
  batch_faces_.resize(views_.size());
  frame_.view_rejected.resize(views_.size());
  frame_.view_used.resize(views_.size());
  residuals_px_.resize(2, model.count());
  sorted_.reserve(static_cast<std::size_t>(model.count()));
  const auto& groups = landmark::landmark_groups();
  for (int l = 0; l < model.count(); ++l) {
    const int landmark = model.landmarks()[static_cast<std::size_t>(l)];
    // Outline points slide along the head as it turns; lips and lids move with the expression.
    if (landmark >= landmark::landmark_count) {
      start_weights_[l] = 0.0;
      continue;
    }
    const landmark::LandmarkGroup group = groups[static_cast<std::size_t>(landmark)];
    start_weights_[l] = group == landmark::LandmarkGroup::Contour ? 0.0
                        : group == landmark::LandmarkGroup::Lips  ? 0.25
                                                                  : 1.0;
  }
  reset_identity();
}

double SubjectTracker::fixed_focal_px() const {
  if (!config_.intrinsics || config_.intrinsics->width_px <= 0) {
    return 0;
  }
  const CameraIntrinsics& known = *config_.intrinsics;
  return 0.5 * static_cast<double>(known.fx + known.fy) * width_px_ / known.width_px;
}

Eigen::Vector2d SubjectTracker::centre_px() const {
  if (config_.intrinsics && config_.intrinsics->width_px > 0) {
    const double scale = static_cast<double>(width_px_) / config_.intrinsics->width_px;
    return {config_.intrinsics->cx * scale, config_.intrinsics->cy * scale};
  }
  return {0.5 * (width_px_ - 1), 0.5 * (height_px_ - 1)};
}

void SubjectTracker::place_cameras() {
  views_.front().camera.centre_px = centre_px();
  views_.front().longer_side_px = static_cast<float>(std::max(width_px_, height_px_));
  for (std::size_t v = 1; v < views_.size(); ++v) {
    const FurtherCamera& view = config_.further_views[v - 1];
    const CameraIntrinsics& lens = view.intrinsics;
    views_[v].camera.centre_px = {lens.cx, lens.cy};
    views_[v].camera.focal_ratio = 0.5 * static_cast<double>(lens.fx + lens.fy) / fixed_focal_px();
    views_[v].camera.view_from_reference = view.view_from_reference;
    views_[v].longer_side_px = static_cast<float>(std::max(lens.width_px, lens.height_px));
  }
}

CameraIntrinsics SubjectTracker::camera() const {
  const Eigen::Vector2d centre = centre_px();
  const auto focal = static_cast<float>(person_.shape.focal_px);
  return {.fx = focal,
          .fy = focal,
          .cx = static_cast<float>(centre.x()),
          .cy = static_cast<float>(centre.y()),
          .width_px = width_px_,
          .height_px = height_px_};
}

void SubjectTracker::set_shape() {
  model_->contract_identity(person_.shape.identity, basis_);
  basis_.bias_mm = person_.landmark_bias_mm;
  ++frame_.shape_version;
}

void SubjectTracker::reset_identity() {
  identity_fit_.reset();
  shading_.reset();
  has_subject_ = false;
  has_previous_ = false;
  const double known = fixed_focal_px();
  person_.shape.focal_px = known > 0 ? known : config_.identity.focal_ratio * std::max(width_px_, height_px_);
  person_.shape.identity = Eigen::VectorXd::Zero(model_->identity_count());
  person_.landmark_bias_mm = Eigen::VectorXd::Zero(Eigen::Index{3} * model_->count());
  person_.usual_residual = 0;
  residual_frames_ = 0;
  verified_frames_ = kVerifyFrames;
  set_shape();
  frame_.state = mesh::TrackingState::Searching;
}

bool SubjectTracker::adopt(const Person& person, int width_px, int height_px) {
  if (person.shape.identity.size() != model_->identity_count() ||
      person.landmark_bias_mm.size() != Eigen::Index{3} * model_->count() ||
      !person.shape.identity.allFinite() || !person.landmark_bias_mm.allFinite() ||
      !(person.shape.focal_px > 0) || !std::isfinite(person.shape.focal_px) || width_px <= 0 ||
      height_px <= 0) {
    return false;
  }
  set_image_size(width_px, height_px);
  person_ = person;
  has_subject_ = true;
  residual_frames_ = person.usual_residual > 0 ? kResidualFrames : 0;
  set_shape();
  ++frame_.subject;
  return true;
}

void SubjectTracker::set_image_size(int width_px, int height_px) {
  width_px_ = width_px;
  height_px_ = height_px;
  place_cameras();
  reset_identity();
}

bool SubjectTracker::usable(const landmark::FaceLandmarks& face, float longer_side_px) const {
  if (face.points_px.cols() != landmark::landmark_count ||
      face.confidence.size() != landmark::landmark_count || !face.points_px.allFinite() ||
      !face.confidence.allFinite() || !face.irises_px.allFinite() ||
      !(face.interocular_px >= kSmallestInterocularPx)) {
    return false;
  }
  return face.points_px.cwiseAbs().maxCoeff() <= kFarthestOutside * longer_side_px;
}

/// From the used view that sees most of the face.
bool SubjectTracker::start_pose() {
  std::size_t best = views_.size();
  float most = -1;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen && views_[v].face->confidence.sum() > most) {
      most = views_[v].face->confidence.sum();
      best = v;
    }
  }
  const landmark::FaceLandmarks& face = *views_[best].face;
  const FitCamera& camera = views_[best].camera;
  for (Eigen::Index l = 0; l < model_->count(); ++l) {
    start_head_mm_.col(l) = basis_.neutral_mm.segment<3>(3 * l);
    const int landmark = model_->landmarks()[static_cast<std::size_t>(l)];
    // The irises have no weight in the start pose.
    start_px_.col(l) = face.points_px.col(landmark < landmark::landmark_count ? landmark : 0).cast<double>();
  }
  const auto pose = pose_from_similarity(start_head_mm_, start_px_, start_weights_,
                                         camera.focal_ratio * person_.shape.focal_px, camera.centre_px);
  if (!pose) {
    return false;
  }
  const Eigen::Isometry3d reference_from_view = camera.view_from_reference.inverse();
  candidate_.pose.rotation = reference_from_view.linear() * pose->rotation;
  candidate_.pose.translation_mm = reference_from_view * pose->translation_mm;
  candidate_.expression.setZero();
  return true;
}

void SubjectTracker::observe_view(std::size_t view) {
  observe(*model_, config_.trust, *views_[view].face, candidate_.pose.translation_mm, person_.shape.focal_px,
          views_[view].camera, observations_[view]);
}

std::optional<double> SubjectTracker::median_residual_px(std::size_t view, bool with_bias) {
  const landmark::FaceLandmarks& face = *views_[view].face;
  if (!coarse_fit_.landmark_term().residuals_px(basis_, observations_[view], person_.shape.focal_px,
                                                candidate_, with_bias, residuals_px_)) {
    return std::nullopt;
  }
  sorted_.clear();
  for (Eigen::Index l = 0; l < model_->count(); ++l) {
    if (landmark::confidence_of(face, model_->landmarks()[static_cast<std::size_t>(l)]) >= kSeen) {
      sorted_.push_back(residuals_px_.col(l).norm());
    }
  }
  if (sorted_.empty()) {
    return std::nullopt;
  }
  return maths::median_of(sorted_);
}

Pose SubjectTracker::pose_in(const FitCamera& camera) const {
  return {camera.view_from_reference.linear() * candidate_.pose.rotation,
          camera.view_from_reference * candidate_.pose.translation_mm};
}

bool SubjectTracker::measure_view(std::size_t view) {
  ViewState& state = views_[view];
  state.residual = std::numeric_limits<double>::infinity();
  const auto of_fit_px = median_residual_px(view, true);
  const auto of_mesh_px = median_residual_px(view, false);
  if (!of_fit_px || !of_mesh_px) {
    return false;
  }
  const double interocular_px = state.camera.focal_ratio * person_.shape.focal_px * model_->interocular_mm() /
                                pose_in(state.camera).translation_mm.z();
  state.reprojection_px = *of_mesh_px;
  state.residual = *of_fit_px / interocular_px;
  return true;
}

/// Of all used views; the frame's own is their mean.
bool SubjectTracker::measure_residual() {
  bool measured = true;
  int count = 0;
  candidate_reprojection_px_ = 0;
  candidate_residual_ = 0;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen) {
      measured = measure_view(v) && measured;
      candidate_reprojection_px_ += views_[v].reprojection_px;
      candidate_residual_ += views_[v].residual;
      ++count;
    }
  }
  candidate_reprojection_px_ /= count;
  candidate_residual_ /= count;
  return measured;
}

/// Cosine of the angle between the face's axis and a view's line of sight.
double SubjectTracker::facing(const ViewState& view) const {
  const Pose pose = pose_in(view.camera);
  return -pose.rotation.col(2).dot(pose.translation_mm.normalized());
}

/// In every view that was used.
bool SubjectTracker::turned() const {
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen && facing(views_[v]) >= kTurned) {
      return false;
    }
  }
  return true;
}

/// No used view has landmarks that can be believed so far round the head.
bool SubjectTracker::beyond_sight() const {
  const float limit = frame_.beyond_sight ? kAgreed : kContradicted;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen && !(facing(views_[v]) < kTurned && views_[v].face->contradiction > limit)) {
      return false;
    }
  }
  return true;
}

bool SubjectTracker::plausible(double largest_residual) const {
  if (!candidate_.pose.rotation.allFinite() || !candidate_.pose.translation_mm.allFinite() ||
      !candidate_.expression.allFinite()) {
    return false;
  }
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen) {
      const double depth_mm = pose_in(views_[v].camera).translation_mm.z();
      if (!(depth_mm >= kNearestHeadMm && depth_mm <= kFarthestHeadMm && facing(views_[v]) >= kFarthestTurn &&
            views_[v].residual <= largest_residual)) {
        return false;
      }
    }
  }
  return true;
}

bool SubjectTracker::jumped(double elapsed_s) const {
  const double interval = std::max(elapsed_s, kShortestIntervalS);
  const Eigen::Vector3d moved = candidate_.pose.translation_mm - previous_.previous.pose.translation_mm;
  return moved.head<2>().norm() > kFastestMmPerS * interval ||
         angle_between(candidate_.pose.rotation, previous_.previous.pose.rotation) >
             kFastestRadPerS * interval;
}

/// With the views that are marked as used.
bool SubjectTracker::fit_used(bool warm, double elapsed_s) {
  if (warm) {
    candidate_ = previous_.previous;
    previous_.elapsed_s = elapsed_s;
  } else if (!start_pose()) {
    return false;
  }
  for (std::size_t v = 0; v < views_.size(); ++v) {
    if (observations_[v].seen) {
      observe_view(v);
    }
  }
  weigh_views(observations_);
  candidate_report_ =
      coarse_fit_.solve(basis_, observations_, person_.shape.focal_px, warm ? &previous_ : nullptr,
                        warm ? kWarmIterations : kColdIterations, candidate_);
  return candidate_report_.outcome != CoarseFitOutcome::NumericalFailure && measure_residual() &&
         plausible(has_subject_ ? kLargestResidual : kLargestFirstResidual);
}

/// With all views that show a face or, where they contradict one another, with those that agree.
bool SubjectTracker::fit(bool warm, double elapsed_s) {
  std::ptrdiff_t used = 0;
  for (std::size_t v = 0; v < views_.size(); ++v) {
    observations_[v].seen = views_[v].face != nullptr;
    used += observations_[v].seen ? 1 : 0;
  }
  if (fit_used(warm, elapsed_s)) {
    return true;
  }
  if (used == 1) {
    return false;
  }
  keep_agreeing_views(warm, elapsed_s);
  for (;;) {
    if (fit_used(warm, elapsed_s)) {
      return true;
    }
    std::size_t worst = 0;
    used = 0;
    double largest = -1;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (observations_[v].seen) {
        ++used;
        if (!(views_[v].residual <= largest)) {
          largest = views_[v].residual;
          worst = v;
        }
      }
    }
    if (used == 1) {
      return false;
    }
    observations_[worst].seen = false;
  }
}

/// Asks each view alone where the face is and marks the largest set of views that agree as used; of equal
/// sets the one that fits best.
void SubjectTracker::keep_agreeing_views(bool warm, double elapsed_s) {
  int most = 0;
  double best = 0;
  for (std::size_t asked = 0; asked < views_.size(); ++asked) {
    if (views_[asked].face == nullptr) {
      continue;
    }
    for (std::size_t v = 0; v < views_.size(); ++v) {
      observations_[v].seen = v == asked;
    }
    if (!fit_used(warm, elapsed_s) || (warm && jumped(elapsed_s))) {
      continue;
    }
    int agreeing = 0;
    double sum = 0;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      if (views_[v].face != nullptr && v != asked) {
        observe_view(v);
        observations_[v].seen = measure_view(v) && views_[v].residual <= kAgreeingResidual;
      }
      agreeing += observations_[v].seen ? 1 : 0;
      sum += observations_[v].seen ? views_[v].residual : 0.0;
    }
    if (agreeing > most || (agreeing == most && sum < best)) {
      most = agreeing;
      best = sum;
      for (std::size_t v = 0; v < views_.size(); ++v) {
        agreeing_[v] = observations_[v].seen ? 1 : 0;
      }
    }
  }
  for (std::size_t v = 0; v < views_.size(); ++v) {
    observations_[v].seen = views_[v].face != nullptr && (most == 0 || agreeing_[v] != 0);
  }
}

const SubjectFrame& SubjectTracker::process(const landmark::FaceLandmarks* face, bool acquired, int width_px,
                                            int height_px, std::int64_t timestamp_ns) {
  const ViewLandmarks view{face, acquired};
  return process({&view, 1}, width_px, height_px, timestamp_ns);
}

const SubjectFrame& SubjectTracker::process(std::span<const ViewLandmarks> views, int width_px, int height_px,
                                            std::int64_t timestamp_ns, const Frame* image) {
  image_ = image;
  frame_.fitted = false;
  frame_.rejected = false;
  std::fill(frame_.view_rejected.begin(), frame_.view_rejected.end(), std::uint8_t{0});
  std::fill(frame_.view_used.begin(), frame_.view_used.end(), std::uint8_t{0});
  if (width_px != width_px_ || height_px != height_px_) {
    set_image_size(width_px, height_px);
  }
  bool found = false;
  bool good = false;
  bool acquired = true;  // in all views that show a face
  for (std::size_t v = 0; v < views_.size(); ++v) {
    const ViewLandmarks view = v < views.size() ? views[v] : ViewLandmarks{};
    const bool is_usable = view.face != nullptr && usable(*view.face, views_[v].longer_side_px);
    views_[v].face = is_usable ? view.face : nullptr;
    found = found || view.face != nullptr;
    good = good || is_usable;
    acquired = acquired && (view.face == nullptr || view.acquired);
  }
  followed_ = followed_ && found && !acquired;
  if (!found) {
    frame_.beyond_sight = false;
    miss(timestamp_ns);
    return frame_;
  }
  const double elapsed_s = seconds(timestamp_ns - last_good_ns_);
  const bool warm = has_previous_ && !acquired && elapsed_s <= kBriefGapS;
  if (good) {
    // A fit that went astray in the last frame must not pull this one along: start anew before giving up.
    good = fit(warm, elapsed_s) || (warm && fit(false, 0));
    good = good && !(warm && jumped(elapsed_s));
  }
  frame_.beyond_sight = good && beyond_sight();
  if (frame_.beyond_sight) {
    miss(timestamp_ns);
  } else if (good) {
    accept(acquired || (elapsed_s > kBriefGapS && !followed_), timestamp_ns);
    followed_ = true;
  } else {
    followed_ = false;
    frame_.rejected = true;
    miss(timestamp_ns);
  }
  for (std::size_t v = 0; v < views_.size(); ++v) {
    const bool shows_one = v < views.size() && views[v].face != nullptr;
    const bool used = frame_.fitted && views_[v].face != nullptr && observations_[v].seen;
    frame_.view_used[v] = used ? 1 : 0;
    frame_.view_rejected[v] = shows_one && !used && !frame_.beyond_sight ? 1 : 0;
    views_[v].face = nullptr;
  }
  return frame_;
}

void SubjectTracker::miss(std::int64_t timestamp_ns) {
  if (frame_.state == mesh::TrackingState::Searching) {
    return;
  }
  frame_.state = mesh::TrackingState::Lost;
  if (seconds(timestamp_ns - last_good_ns_) > kLostForS) {
    frame_.state = mesh::TrackingState::Searching;
    has_previous_ = false;
    if (!has_subject_) {
      // Half a batch of somebody who left; who comes next may be another person.
      reset_identity();
    }
  }
}

void SubjectTracker::accept(bool found_afresh, std::int64_t timestamp_ns) {
  last_good_ns_ = timestamp_ns;
  if (has_subject_) {
    frame_.state = mesh::TrackingState::Tracking;
    if (found_afresh && residual_frames_ >= kVerifyFrames) {
      verified_frames_ = 0;
      verified_residual_sum_ = 0;
    }
    has_previous_ = true;
    if (!still_the_same_person()) {
      reset_identity();
    }
  }
  if (!has_subject_) {
    frame_.state = mesh::TrackingState::Acquiring;
    has_previous_ = true;
    if (!acquire()) {
      reset_identity();
      frame_.rejected = true;
      return;
    }
  }
  previous_.previous = candidate_;
  frame_.face = candidate_;
  frame_.fitted = true;
  frame_.reprojection_px = candidate_reprojection_px_;
  frame_.relative_residual = candidate_residual_;
  frame_.fit = candidate_report_;
}

bool SubjectTracker::still_the_same_person() {
  if (turned()) {
    return true;  // the fit is worse on everybody's turned head
  }
  if (verified_frames_ < kVerifyFrames) {
    ++verified_frames_;
    verified_residual_sum_ += candidate_residual_;
    const double mean = verified_residual_sum_ / verified_frames_;
    return verified_frames_ < kVerifyFrames ||
           mean <= std::max(kOtherPersonFactor * person_.usual_residual,
                            person_.usual_residual + kOtherPersonDifference);
  }
  residual_frames_ = std::min(residual_frames_ + 1, kResidualFrames);
  person_.usual_residual += (candidate_residual_ - person_.usual_residual) / residual_frames_;
  return true;
}

bool SubjectTracker::worth_adding() const {
  if (frames_since_added_ > kFramesBetweenLikeOnes) {
    return true;
  }
  for (int f = 0; f < identity_fit_->frame_count(); ++f) {
    const FrameState& other = identity_fit_->frame(f);
    const double pose = angle_between(candidate_.pose.rotation, other.pose.rotation) / kNewPoseRad;
    const double expression = (candidate_.expression - other.expression).norm() / kNewExpression;
    if (pose + expression < 1.0) {
      return false;
    }
  }
  return true;
}

bool SubjectTracker::acquire() {
  if (!identity_fit_) {
    std::vector<FitCamera> cameras;
    for (const ViewState& view : views_) {
      cameras.push_back(view.camera);
    }
    identity_fit_.emplace(*model_, *prior_, config_.trust, config_.identity, std::max(width_px_, height_px_),
                          fixed_focal_px(), std::move(cameras));
    if (config_.shading_model != nullptr) {
      shading_.emplace(*config_.shading_model);
    }
    shading_steps_ = 0;
    frames_since_added_ = 0;
    settling_frames_ = 0;
  }
  ++frames_since_added_;
  if (identity_fit_->frame_count() < config_.acquisition_frames) {
    if (worth_adding()) {
      for (std::size_t v = 0; v < views_.size(); ++v) {
        batch_faces_[v] = observations_[v].seen ? views_[v].face : nullptr;
      }
      identity_fit_->add_frame(batch_faces_, candidate_);
      if (shading_) {
        shading_->add_frame(image_ != nullptr ? *image_ : Frame{}, batch_faces_.front());
      }
      frames_since_added_ = 0;
      const int count = identity_fit_->frame_count();
      if (std::find(kProvisionalAt.begin(), kProvisionalAt.end(), count) != kProvisionalAt.end()) {
        identity_fit_->improve(kProvisionalIterations);
        person_.shape = identity_fit_->shape();
        candidate_ = identity_fit_->frame(count - 1);
        set_shape();
        return measure_residual();
      }
    }
    return true;
  }
  if (shading_steps_ == 0) {
    ++settling_frames_;
    const CoarseFitReport report = identity_fit_->improve(kSettlingIterations);
    if (report.outcome == CoarseFitOutcome::NotConverged && settling_frames_ < kMostSettlingFrames) {
      return true;
    }
  }
  if (shade()) {
    return true;
  }
  take_identity();
  set_shape();
  // A batch can agree on a shape that does not even fit its last frame: it was no face, or several.
  if (!fit(false, 0)) {
    return false;
  }
  ++frame_.subject;
  frame_.state = mesh::TrackingState::Tracking;
  return true;
}

/// One step by the pictures' shading or by the landmarks after it. False where there is none left to be made.
bool SubjectTracker::shade() {
  if (!shading_ || shading_steps_ == kShadingSteps) {
    return false;
  }
  if (shading_steps_ % (1 + kIterationsAfterShading) == 0) {
    std::vector<const FrameState*> states;
    states.reserve(static_cast<std::size_t>(identity_fit_->frame_count()));
    for (int f = 0; f < identity_fit_->frame_count(); ++f) {
      states.push_back(&identity_fit_->frame(f));
    }
    const std::optional<IdentityEvidence> evidence =
        shading_->evidence(identity_fit_->shape(), centre_px(), states);
    if (!evidence) {
      shading_steps_ = kShadingSteps;
      return false;
    }
    identity_fit_->set_evidence(*evidence);
  } else {
    identity_fit_->improve(1);
  }
  ++shading_steps_;
  return true;
}

void SubjectTracker::take_identity() {
  person_.shape = identity_fit_->shape();
  person_.landmark_bias_mm = identity_fit_->landmark_bias_mm();
  identity_fit_.reset();
  shading_.reset();
  has_subject_ = true;
}

bool SubjectTracker::settle() {
  if (!has_subject_ && identity_fit_ && identity_fit_->frame_count() > 0) {
    identity_fit_->improve(kMostSettlingFrames * kSettlingIterations);
    while (shade()) {
    }
    take_identity();
    set_shape();
    ++frame_.subject;
  }
  return has_subject_;
}

}  // namespace facet::track
