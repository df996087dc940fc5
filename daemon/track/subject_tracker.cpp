#include "track/subject_tracker.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace facet::track {
namespace {

/// Levenberg-Marquardt steps of a frame that continues the last one, and of one that starts anew.
constexpr int kWarmIterations = 6;
constexpr int kColdIterations = 25;

/// Median residual beyond which a frame is not believed, as a fraction of the interocular distance: while the
/// identity is still the mean face, and once it is known.
constexpr double kLargestFirstResidual = 0.10;
constexpr double kLargestResidual = 0.06;
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
  residuals_px_.resize(2, model.count());
  sorted_.reserve(static_cast<std::size_t>(model.count()));
  const auto& groups = landmark_groups();
  for (int l = 0; l < model.count(); ++l) {
    const int landmark = model.landmarks()[static_cast<std::size_t>(l)];
    // Outline points slide along the head as it turns; lips and lids move with the expression.
    if (landmark >= landmark_count) {
      start_weights_[l] = 0.0;
      continue;
    }
    const LandmarkGroup group = groups[static_cast<std::size_t>(landmark)];
    start_weights_[l] = group == LandmarkGroup::Contour ? 0.0 : group == LandmarkGroup::Lips ? 0.25 : 1.0;
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

CameraIntrinsics SubjectTracker::camera() const {
  const Eigen::Vector2d centre = centre_px();
  const auto focal = static_cast<float>(subject_.shape.focal_px);
  return {.fx = focal,
          .fy = focal,
          .cx = static_cast<float>(centre.x()),
          .cy = static_cast<float>(centre.y()),
          .width_px = width_px_,
          .height_px = height_px_};
}

void SubjectTracker::set_shape() {
  model_->contract_identity(subject_.shape.identity, basis_);
  basis_.bias_mm = subject_.landmark_bias_mm;
  ++frame_.shape_version;
}

void SubjectTracker::reset_identity() {
  identity_fit_.reset();
  has_subject_ = false;
  has_previous_ = false;
  const double known = fixed_focal_px();
  subject_.shape.focal_px =
      known > 0 ? known : config_.identity.focal_ratio * std::max(width_px_, height_px_);
  subject_.shape.identity = Eigen::VectorXd::Zero(model_->identity_count());
  subject_.landmark_bias_mm = Eigen::VectorXd::Zero(Eigen::Index{3} * model_->count());
  subject_.usual_residual = 0;
  residual_frames_ = 0;
  verified_frames_ = kVerifyFrames;
  set_shape();
  frame_.state = mesh::TrackingState::Searching;
}

bool SubjectTracker::adopt(const Subject& subject, int width_px, int height_px) {
  if (subject.shape.identity.size() != model_->identity_count() ||
      subject.landmark_bias_mm.size() != Eigen::Index{3} * model_->count() ||
      !subject.shape.identity.allFinite() || !subject.landmark_bias_mm.allFinite() ||
      !(subject.shape.focal_px > 0) || !std::isfinite(subject.shape.focal_px) || width_px <= 0 ||
      height_px <= 0) {
    return false;
  }
  width_px_ = width_px;
  height_px_ = height_px;
  reset_identity();
  subject_ = subject;
  has_subject_ = true;
  residual_frames_ = subject.usual_residual > 0 ? kResidualFrames : 0;
  set_shape();
  ++frame_.subject;
  return true;
}

void SubjectTracker::set_image_size(int width_px, int height_px) {
  width_px_ = width_px;
  height_px_ = height_px;
  reset_identity();
}

bool SubjectTracker::usable(const FaceLandmarks& face) const {
  if (face.points_px.cols() != landmark_count || face.confidence.size() != landmark_count ||
      !face.points_px.allFinite() || !face.confidence.allFinite() || !face.irises_px.allFinite() ||
      !(face.interocular_px >= kSmallestInterocularPx)) {
    return false;
  }
  const auto limit = kFarthestOutside * static_cast<float>(std::max(width_px_, height_px_));
  return face.points_px.cwiseAbs().maxCoeff() <= limit;
}

bool SubjectTracker::start_pose(const FaceLandmarks& face) {
  for (Eigen::Index l = 0; l < model_->count(); ++l) {
    start_head_mm_.col(l) = basis_.neutral_mm.segment<3>(3 * l);
    const int landmark = model_->landmarks()[static_cast<std::size_t>(l)];
    // The irises have no weight in the start pose.
    start_px_.col(l) = face.points_px.col(landmark < landmark_count ? landmark : 0).cast<double>();
  }
  const auto pose =
      pose_from_similarity(start_head_mm_, start_px_, start_weights_, subject_.shape.focal_px, centre_px());
  if (!pose) {
    return false;
  }
  candidate_.pose = *pose;
  candidate_.expression.setZero();
  return true;
}

std::optional<double> SubjectTracker::median_residual_px(const FaceLandmarks& face, bool with_bias) {
  if (!coarse_fit_.landmark_term().residuals_px(basis_, observation_, subject_.shape.focal_px, candidate_,
                                                with_bias, residuals_px_)) {
    return std::nullopt;
  }
  sorted_.clear();
  for (Eigen::Index l = 0; l < model_->count(); ++l) {
    if (confidence_of(face, model_->landmarks()[static_cast<std::size_t>(l)]) >= kSeen) {
      sorted_.push_back(residuals_px_.col(l).norm());
    }
  }
  if (sorted_.empty()) {
    return std::nullopt;
  }
  const auto middle = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 2);
  std::nth_element(sorted_.begin(), middle, sorted_.end());
  return *middle;
}

bool SubjectTracker::measure_residual(const FaceLandmarks& face) {
  const auto of_fit_px = median_residual_px(face, true);
  const auto of_mesh_px = median_residual_px(face, false);
  if (!of_fit_px || !of_mesh_px) {
    return false;
  }
  const double interocular_px =
      subject_.shape.focal_px * model_->interocular_mm() / candidate_.pose.translation_mm.z();
  candidate_reprojection_px_ = *of_mesh_px;
  candidate_residual_ = *of_fit_px / interocular_px;
  return true;
}

bool SubjectTracker::plausible(double largest_residual) const {
  const Pose& pose = candidate_.pose;
  const double depth_mm = pose.translation_mm.z();
  const double facing = -pose.rotation.col(2).dot(pose.translation_mm.normalized());
  return pose.rotation.allFinite() && pose.translation_mm.allFinite() && candidate_.expression.allFinite() &&
         depth_mm >= kNearestHeadMm && depth_mm <= kFarthestHeadMm && facing >= kFarthestTurn &&
         candidate_residual_ <= largest_residual;
}

bool SubjectTracker::jumped(double elapsed_s) const {
  const double interval = std::max(elapsed_s, kShortestIntervalS);
  const Eigen::Vector3d moved = candidate_.pose.translation_mm - previous_.previous.pose.translation_mm;
  return moved.head<2>().norm() > kFastestMmPerS * interval ||
         angle_between(candidate_.pose.rotation, previous_.previous.pose.rotation) >
             kFastestRadPerS * interval;
}

bool SubjectTracker::fit(const FaceLandmarks& face, bool warm, double elapsed_s) {
  if (warm) {
    candidate_ = previous_.previous;
    previous_.elapsed_s = elapsed_s;
  } else if (!start_pose(face)) {
    return false;
  }
  observe(*model_, config_.trust, face, candidate_.pose.translation_mm.z(), subject_.shape.focal_px,
          centre_px(), observation_);
  candidate_report_ =
      coarse_fit_.solve(basis_, observation_, subject_.shape.focal_px, warm ? &previous_ : nullptr,
                        warm ? kWarmIterations : kColdIterations, candidate_);
  return candidate_report_.outcome != FitOutcome::NumericalFailure && measure_residual(face) &&
         plausible(has_subject_ ? kLargestResidual : kLargestFirstResidual);
}

const SubjectFrame& SubjectTracker::process(const FaceLandmarks* face, bool acquired, int width_px,
                                            int height_px, std::int64_t timestamp_ns) {
  frame_.fitted = false;
  frame_.rejected = false;
  if (width_px != width_px_ || height_px != height_px_) {
    set_image_size(width_px, height_px);
  }
  if (face == nullptr) {
    miss(timestamp_ns);
    return frame_;
  }
  const double elapsed_s = seconds(timestamp_ns - last_good_ns_);
  const bool warm = has_previous_ && !acquired && elapsed_s <= kBriefGapS;
  bool good = usable(*face);
  if (good) {
    // A fit that went astray in the last frame must not pull this one along: start anew before giving up.
    good = fit(*face, warm, elapsed_s) || (warm && fit(*face, false, 0));
    good = good && !(warm && jumped(elapsed_s));
  }
  if (good) {
    accept(*face, acquired || elapsed_s > kBriefGapS, timestamp_ns);
  } else {
    frame_.rejected = true;
    miss(timestamp_ns);
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

void SubjectTracker::accept(const FaceLandmarks& face, bool found_afresh, std::int64_t timestamp_ns) {
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
    if (!acquire(face)) {
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
  if (verified_frames_ < kVerifyFrames) {
    ++verified_frames_;
    verified_residual_sum_ += candidate_residual_;
    const double mean = verified_residual_sum_ / verified_frames_;
    return verified_frames_ < kVerifyFrames ||
           mean <= std::max(kOtherPersonFactor * subject_.usual_residual,
                            subject_.usual_residual + kOtherPersonDifference);
  }
  residual_frames_ = std::min(residual_frames_ + 1, kResidualFrames);
  subject_.usual_residual += (candidate_residual_ - subject_.usual_residual) / residual_frames_;
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

bool SubjectTracker::acquire(const FaceLandmarks& face) {
  if (!identity_fit_) {
    identity_fit_.emplace(*model_, *prior_, config_.trust, config_.identity, std::max(width_px_, height_px_),
                          fixed_focal_px(), centre_px());
    frames_since_added_ = 0;
    settling_frames_ = 0;
  }
  ++frames_since_added_;
  if (identity_fit_->frame_count() < config_.acquisition_frames) {
    if (worth_adding()) {
      identity_fit_->add_frame(face, candidate_);
      frames_since_added_ = 0;
      const int count = identity_fit_->frame_count();
      if (std::find(kProvisionalAt.begin(), kProvisionalAt.end(), count) != kProvisionalAt.end()) {
        identity_fit_->improve(kProvisionalIterations);
        subject_.shape = identity_fit_->shape();
        candidate_ = identity_fit_->frame(count - 1);
        set_shape();
        return measure_residual(face);
      }
    }
    return true;
  }
  ++settling_frames_;
  const FitReport report = identity_fit_->improve(kSettlingIterations);
  if (report.outcome == FitOutcome::NotConverged && settling_frames_ < kMostSettlingFrames) {
    return true;
  }
  subject_.shape = identity_fit_->shape();
  subject_.landmark_bias_mm = identity_fit_->landmark_bias_mm();
  identity_fit_.reset();
  has_subject_ = true;
  set_shape();
  // A batch can agree on a shape that does not even fit its last frame: it was no face, or several.
  if (!fit(face, false, 0)) {
    return false;
  }
  ++frame_.subject;
  frame_.state = mesh::TrackingState::Tracking;
  return true;
}

bool SubjectTracker::settle() {
  if (!has_subject_ && identity_fit_ && identity_fit_->frame_count() > 0) {
    identity_fit_->improve(kMostSettlingFrames * kSettlingIterations);
    subject_.shape = identity_fit_->shape();
    subject_.landmark_bias_mm = identity_fit_->landmark_bias_mm();
    identity_fit_.reset();
    has_subject_ = true;
    set_shape();
    ++frame_.subject;
  }
  return has_subject_;
}

}  // namespace facet::track
