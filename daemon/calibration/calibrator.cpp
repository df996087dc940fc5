#include "calibration/calibrator.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "capture/epipolar.hpp"
#include "facet/error.hpp"
#include "maths/statistics.hpp"

namespace facet::calibration {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;
/// Beyond this relative standard deviation of the focal length the views do not tell it.
constexpr double kMostFocalSigma = 0.01;

[[noreturn]] void fail(const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, what);
}

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * kDegrees;
}

/// Where a board is seen, in the camera's frame, by a lens without distortion; nothing where no pose fits.
std::optional<Eigen::Isometry3d> pose_of(const std::vector<Eigen::Vector3d>& corners, const BoardView& view,
                                         const capture::Lens& lens) {
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> seen;
  for (std::size_t i = 0; i < view.ids.size(); ++i) {
    const Eigen::Vector3d& corner = corners[static_cast<std::size_t>(view.ids[i])];
    board.emplace_back(corner.x(), corner.y(), corner.z());
    seen.emplace_back(view.px[i].x(), view.px[i].y());
  }
  const cv::Matx33d matrix(lens.fx_px, 0, lens.cx_px, 0, lens.fy_px, lens.cy_px, 0, 0, 1);
  cv::Vec3d turn;
  cv::Vec3d shift;
  if (!cv::solvePnP(board, seen, matrix, cv::noArray(), turn, shift) || !(shift[2] > 0)) {
    return std::nullopt;
  }
  const Eigen::Vector3d axis(turn[0], turn[1], turn[2]);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  if (axis.norm() > 0) {
    pose.linear() = Eigen::AngleAxisd(axis.norm(), axis.normalized()).toRotationMatrix();
  }
  pose.translation() << shift[0], shift[1], shift[2];
  return pose;
}

class Calibrator {
 public:
  Calibrator(const Board& board, const std::vector<CalibrationCamera>& cameras,
             const std::vector<CalibrationView>& views, const CalibratorOptions& options,
             const CalibrationProgress& progress)
      : corners_(corners_mm(board)),
        centre_mm_(0.5 * board.columns * board.square_mm, 0.5 * board.rows * board.square_mm, 0),
        cameras_(cameras),
        views_(views),
        options_(options),
        progress_(progress),
        used_(cameras.size(), std::vector<bool>(views.size())),
        camera_from_board_(cameras.size(), std::vector<Eigen::Isometry3d>(views.size())),
        lenses_(cameras.size()),
        alone_px_(cameras.size()) {}

  Calibration run() {
    for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
      report_progress(fmt::format("Camera '{}' alone", cameras_[camera].name), camera);
      calibrate_alone(camera);
    }
    report_progress("All cameras together", cameras_.size());
    place_cameras();
    BundleProblem problem = joint_problem();
    const BundleResult fitted = adjust_and_reject(problem);
    fill(problem, fitted);
    report_progress("Done", cameras_.size() + 1);
    return std::move(result_);
  }

 private:
  void report_progress(const std::string& what, std::size_t done) const {
    if (progress_) {
      progress_(what, done, cameras_.size() + 1);
    }
  }

  const BoardView& seen(std::size_t camera, std::size_t view) const { return views_[view].seen[camera]; }

  void reject(std::size_t camera, std::size_t view, const std::string& reason) {
    used_[camera][view] = false;
    result_.rejected.push_back({views_[view].name, cameras_[camera].name, reason});
  }

  std::size_t used_views(std::size_t camera) const {
    return static_cast<std::size_t>(std::count(used_[camera].begin(), used_[camera].end(), true));
  }

  void require_views(std::size_t camera) const {
    const std::size_t count = used_views(camera);
    if (count >= static_cast<std::size_t>(options_.least_views)) {
      return;
    }
    std::map<std::string, int> reasons;
    for (const RejectedPicture& picture : result_.rejected) {
      if (picture.camera == cameras_[camera].name) {
        ++reasons[picture.reason.substr(0, picture.reason.find(':'))];
      }
    }
    std::vector<std::string> texts;
    texts.reserve(reasons.size());
    for (const auto& [reason, times] : reasons) {
      texts.push_back(fmt::format("{} times: {}", times, reason));
    }
    fail(
        fmt::format("camera '{}': the board can be used in only {} of {} pictures, {} are needed{}{}. Check "
                    "that --board, --squares and --dictionary are those of the board, and take more pictures",
                    cameras_[camera].name, count, views_.size(), options_.least_views,
                    texts.empty() ? "" : "; ", fmt::join(texts, "; ")));
  }

  void add_observations(BundleProblem& problem, std::size_t problem_camera, std::size_t problem_view,
                        std::size_t camera, std::size_t view) const {
    const BoardView& board = seen(camera, view);
    for (std::size_t i = 0; i < board.ids.size(); ++i) {
      problem.observations.push_back(
          {problem_camera, problem_view, corners_[static_cast<std::size_t>(board.ids[i])], board.px[i]});
    }
  }

  capture::Lens first_guess(std::size_t camera) const {
    std::vector<std::vector<cv::Point3f>> boards;
    std::vector<std::vector<cv::Point2f>> pictures;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[camera][view]) {
        boards.emplace_back();
        pictures.emplace_back();
        for (std::size_t i = 0; i < seen(camera, view).ids.size(); ++i) {
          const Eigen::Vector3f corner =
              corners_[static_cast<std::size_t>(seen(camera, view).ids[i])].cast<float>();
          const Eigen::Vector2f px = seen(camera, view).px[i].cast<float>();
          boards.back().emplace_back(corner.x(), corner.y(), corner.z());
          pictures.back().emplace_back(px.x(), px.y());
        }
      }
    }
    const int width = cameras_[camera].width_px;
    const cv::Mat matrix = cv::initCameraMatrix2D(boards, pictures, {width, cameras_[camera].height_px}, 1.0);
    capture::Lens lens;
    lens.width_px = width;
    lens.height_px = cameras_[camera].height_px;
    lens.fx_px = matrix.at<double>(0, 0);
    // Views that tell nothing of the focal length give any number.
    if (!(lens.fx_px > 0.2 * width && lens.fx_px < 20 * width)) {
      lens.fx_px = 1.2 * width;
    }
    lens.fy_px = lens.fx_px;
    lens.cx_px = 0.5 * (width - 1);
    lens.cy_px = 0.5 * (lens.height_px - 1);
    return lens;
  }

  void calibrate_alone(std::size_t camera) {
    for (std::size_t view = 0; view < views_.size(); ++view) {
      used_[camera][view] = true;
      if (!seen(camera, view).usable()) {
        reject(camera, view, seen(camera, view).problem);
      }
    }
    require_views(camera);
    capture::Lens& lens = lenses_[camera];
    lens = first_guess(camera);
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[camera][view]) {
        const auto pose = pose_of(corners_, seen(camera, view), lens);
        if (pose) {
          camera_from_board_[camera][view] = *pose;
        } else {
          reject(camera, view, "no pose of the board explains what is seen");
        }
      }
    }
    BundleResult fitted;
    for (bool again = true; again;) {
      require_views(camera);
      fitted = adjust_alone(camera);
      again = reject_oblique(camera);
      again = reject_outliers({camera}, fitted_errors(camera)) || again;
    }
    alone_px_[camera] = fitted.rms_px;
    require_focal_length(camera, fitted);
  }

  BundleResult adjust_alone(std::size_t camera) {
    BundleProblem problem;
    problem.lenses = {lenses_[camera]};
    std::vector<std::size_t> view_of;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[camera][view]) {
        add_observations(problem, 0, view_of.size(), camera, view);
        problem.world_from_board.push_back(camera_from_board_[camera][view]);
        view_of.push_back(view);
      }
    }
    // Before the distortion is known errors of tens of pixels are no outliers.
    adjust(problem, {.huber_px = 20, .free_k3 = options_.free_k3});
    BundleResult fitted = adjust(problem, {.free_k3 = options_.free_k3});
    if (fitted.outcome == BundleOutcome::NumericalFailure) {
      fail(fmt::format("camera '{}': {}", cameras_[camera].name, fitted.message));
    }
    lenses_[camera] = problem.lenses[0];
    for (std::size_t i = 0; i < view_of.size(); ++i) {
      camera_from_board_[camera][view_of[i]] = problem.world_from_board[i];
    }
    return fitted;
  }

  /// Reprojection error (rms) of one picture under the given camera and board pose.
  double picture_rms(std::size_t camera, std::size_t view, const capture::Lens& lens,
                     const Eigen::Isometry3d& world_from_board) const {
    BundleProblem one{{lens}, {world_from_board}, {}};
    add_observations(one, 0, 0, camera, view);
    double squares = 0;
    for (const CornerObservation& observation : one.observations) {
      squares += residual_px(one, observation, nullptr, nullptr, nullptr).squaredNorm();
    }
    return std::sqrt(squares / static_cast<double>(one.observations.size()));
  }

  /// [view] for one camera alone; NaN where it is not used.
  std::vector<std::vector<double>> fitted_errors(std::size_t camera) const {
    std::vector<double> errors(views_.size(), std::numeric_limits<double>::quiet_NaN());
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[camera][view]) {
        errors[view] = picture_rms(camera, view, lenses_[camera], camera_from_board_[camera][view]);
      }
    }
    return {errors};
  }

  bool reject_oblique(std::size_t camera) {
    bool any = false;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[camera][view]) {
        const Eigen::Isometry3d& pose = camera_from_board_[camera][view];
        const double angle = angle_between(pose.linear().col(2), pose * centre_mm_);
        if (angle > options_.most_oblique_deg) {
          reject(camera, view,
                 fmt::format("too oblique: the board is seen at {:.0f} degrees, {:.0f} are allowed", angle,
                             options_.most_oblique_deg));
          any = true;
        }
      }
    }
    return any;
  }

  /// errors [cameras.size()][view_count], NaN where not used.
  bool reject_outliers(const std::vector<std::size_t>& cameras,
                       const std::vector<std::vector<double>>& errors) {
    bool any = false;
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      std::vector<double> known;
      std::copy_if(errors[i].begin(), errors[i].end(), std::back_inserter(known),
                   [](double error) { return !std::isnan(error); });
      if (known.empty()) {
        continue;
      }
      const double limit =
          std::max(options_.most_error_px, options_.most_error_factor * maths::median_of(known));
      for (std::size_t view = 0; view < views_.size(); ++view) {
        if (errors[i][view] > limit) {
          reject(cameras[i], view,
                 fmt::format("does not fit: reprojection error {:.2f} px, the others have {:.2f} px",
                             errors[i][view], maths::median_of(known)));
          any = true;
        }
      }
    }
    return any;
  }

  double largest_tilt_deg(std::size_t camera) const {
    double largest = 0;
    for (std::size_t a = 0; a < views_.size(); ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        if (used_[camera][a] && used_[camera][b]) {
          largest = std::max(largest, angle_between(camera_from_board_[camera][a].linear().col(2),
                                                    camera_from_board_[camera][b].linear().col(2)));
        }
      }
    }
    return largest;
  }

  void require_focal_length(std::size_t camera, const BundleResult& fitted) const {
    const capture::Lens& lens = lenses_[camera];
    const double sigma =
        std::max(fitted.intrinsic_sigma[0][0] / lens.fx_px, fitted.intrinsic_sigma[0][1] / lens.fy_px);
    const double tilt = largest_tilt_deg(camera);
    constexpr double kLeastTilt_deg = 10;
    if (sigma <= kMostFocalSigma && tilt >= kLeastTilt_deg && lens.fx_px > 0 && lens.fy_px > 0) {
      return;
    }
    fail(fmt::format(
        "camera '{}': the focal length can't be seen in these views ({:.0f} px, uncertain by {:.1f} "
        "%; the board was tilted by {:.0f} degrees between views at most). Tilt the board by 20 to 45 "
        "degrees to all sides",
        cameras_[camera].name, lens.fx_px, 100 * std::min(sigma, 9.99), tilt));
  }

  std::size_t shared_views(std::size_t a, std::size_t b) const {
    std::size_t count = 0;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      count += used_[a][view] && used_[b][view] ? 1 : 0;
    }
    return count;
  }

  /// b_from_a that most views agree on: the one with the least sum of distances to the others.
  Eigen::Isometry3d relative_pose(std::size_t a, std::size_t b) const {
    std::vector<Eigen::Isometry3d> found;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (used_[a][view] && used_[b][view]) {
        found.push_back(camera_from_board_[b][view] * camera_from_board_[a][view].inverse());
      }
    }
    constexpr double kRadianAsMm = 500;  // a face's distance: both parts move the picture about alike
    double least = std::numeric_limits<double>::infinity();
    Eigen::Isometry3d best = found.front();
    for (const Eigen::Isometry3d& one : found) {
      double sum = 0;
      for (const Eigen::Isometry3d& other : found) {
        sum += (one.translation() - other.translation()).norm() +
               kRadianAsMm * Eigen::AngleAxisd(one.linear().transpose() * other.linear()).angle();
      }
      if (sum < least) {
        least = sum;
        best = one;
      }
    }
    return best;
  }

  /// Poses of all cameras in the first one's frame, along the tree of most shared views (Prim).
  void place_cameras() {
    std::vector<bool> placed(cameras_.size());
    placed[0] = true;
    for (std::size_t count = 1; count < cameras_.size(); ++count) {
      std::size_t best = 0;
      std::pair<std::size_t, std::size_t> link;
      for (std::size_t a = 0; a < cameras_.size(); ++a) {
        for (std::size_t b = 0; b < cameras_.size(); ++b) {
          if (placed[a] && !placed[b] && shared_views(a, b) > best) {
            best = shared_views(a, b);
            link = {a, b};
          }
        }
      }
      if (best == 0) {
        std::vector<std::string> names[2];
        for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
          names[placed[camera] ? 0 : 1].push_back(cameras_[camera].name);
        }
        fail(
            fmt::format("no view shows the board to one of '{}' and to one of '{}' at once: take views where "
                        "it is seen by both sides",
                        fmt::join(names[0], "', '"), fmt::join(names[1], "', '")));
      }
      const auto [a, b] = link;
      lenses_[b].camera_from_rig = relative_pose(a, b) * lenses_[a].camera_from_rig;
      placed[b] = true;
    }
  }

  BundleProblem joint_problem() {
    BundleProblem problem;
    problem.lenses = lenses_;
    joint_views_.clear();
    for (std::size_t view = 0; view < views_.size(); ++view) {
      std::optional<std::size_t> best;
      for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
        if (used_[camera][view] && (!best || seen(camera, view).ids.size() > seen(*best, view).ids.size())) {
          best = camera;
        }
      }
      if (!best) {
        continue;
      }
      for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
        if (used_[camera][view]) {
          add_observations(problem, camera, joint_views_.size(), camera, view);
        }
      }
      problem.world_from_board.push_back(lenses_[*best].camera_from_rig.inverse() *
                                         camera_from_board_[*best][view]);
      joint_views_.push_back(view);
    }
    return problem;
  }

  BundleResult adjust_and_reject(BundleProblem& problem) {
    std::vector<std::size_t> all(cameras_.size());
    for (std::size_t camera = 0; camera < all.size(); ++camera) {
      all[camera] = camera;
    }
    for (;;) {
      BundleResult fitted = adjust(problem, {.free_k3 = options_.free_k3});
      if (fitted.outcome == BundleOutcome::NumericalFailure) {
        fail("the cameras can't be brought into one frame: " + fitted.message);
      }
      std::vector<std::vector<double>> errors(
          cameras_.size(), std::vector<double>(views_.size(), std::numeric_limits<double>::quiet_NaN()));
      for (std::size_t i = 0; i < joint_views_.size(); ++i) {
        for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
          if (used_[camera][joint_views_[i]]) {
            errors[camera][joint_views_[i]] =
                picture_rms(camera, joint_views_[i], problem.lenses[camera], problem.world_from_board[i]);
          }
        }
      }
      require_agreement(errors);
      if (!reject_outliers(all, errors)) {
        return fitted;
      }
      for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
        require_views(camera);
      }
      const std::vector<capture::Lens> lenses = problem.lenses;
      place_cameras();
      problem = joint_problem();
      problem.lenses = lenses;
    }
  }

  /// A camera that fits its own pictures but not those of the others saw the board elsewhere.
  void require_agreement(const std::vector<std::vector<double>>& errors) const {
    for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
      std::vector<double> known;
      std::copy_if(errors[camera].begin(), errors[camera].end(), std::back_inserter(known),
                   [](double error) { return !std::isnan(error); });
      const double limit = std::max(2 * options_.most_error_px, 4 * alone_px_[camera]);
      if (!known.empty() && maths::median_of(known) > limit) {
        fail(fmt::format(
            "camera '{}' and the others do not agree where the board was: the reprojection error is "
            "{:.2f} px for it alone and {:.2f} px together. Its pictures were not taken at the same "
            "moments (files of one name belong together), or the board moved",
            cameras_[camera].name, alone_px_[camera], maths::median_of(known)));
      }
    }
  }

  std::vector<capture::StereoPair> given_pairs() const {
    std::vector<capture::StereoPair> pairs;
    const auto index_of = [&](const std::string& name) {
      const auto at = std::find_if(cameras_.begin(), cameras_.end(),
                                   [&](const CalibrationCamera& camera) { return camera.name == name; });
      if (at == cameras_.end()) {
        throw Error(ErrorKind::Usage, fmt::format("--pair: there is no camera '{}'", name));
      }
      return static_cast<std::size_t>(at - cameras_.begin());
    };
    for (const auto& [left, right] : options_.pairs) {
      const capture::StereoPair pair{index_of(left), index_of(right)};
      if (pair.left == pair.right) {
        throw Error(ErrorKind::Usage, fmt::format("--pair {}:{}: a pair needs two cameras", left, right));
      }
      const Eigen::Vector3d right_in_left = result_.rig.cameras[pair.left].lens.camera_from_rig *
                                            result_.rig.cameras[pair.right].lens.centre_mm();
      if (std::abs(right_in_left.x()) >= std::abs(right_in_left.y()) && right_in_left.x() < 0) {
        throw Error(ErrorKind::Usage,
                    fmt::format("--pair {}:{}: camera '{}' stands {:.1f} mm to the left of '{}': either name "
                                "them the other way round, or their pictures were swapped",
                                left, right, right, -right_in_left.x(), left));
      }
      pairs.push_back(pair);
    }
    return pairs;
  }

  void fill(const BundleProblem& problem, const BundleResult& fitted) {
    const Eigen::Isometry3d world_from_rig = mean_camera(problem.lenses);
    result_.rms_px = fitted.rms_px;
    result_.views = joint_views_.size();
    for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
      capture::Lens lens = problem.lenses[camera];
      lens.camera_from_rig = lens.camera_from_rig * world_from_rig;
      lens.camera_from_rig.linear() =
          Eigen::Quaterniond(lens.camera_from_rig.linear()).normalized().toRotationMatrix();
      result_.rig.cameras.push_back({cameras_[camera].name, lens, cameras_[camera].colour});
      result_.cameras.push_back({.name = cameras_[camera].name,
                                 .views = used_views(camera),
                                 .sigma = fitted.intrinsic_sigma[camera],
                                 .largest_tilt_deg = largest_tilt_deg(camera)});
    }
    std::vector<double> squares(cameras_.size());
    for (const CornerObservation& observation : problem.observations) {
      const Eigen::Vector2d error = residual_px(problem, observation, nullptr, nullptr, nullptr);
      result_.errors.push_back({observation.camera, joint_views_[observation.view], observation.px, error});
      squares[observation.camera] += error.squaredNorm();
      ++result_.cameras[observation.camera].corners;
    }
    for (std::size_t camera = 0; camera < cameras_.size(); ++camera) {
      CameraReport& report = result_.cameras[camera];
      report.rms_px =
          std::sqrt(squares[camera] / static_cast<double>(std::max<std::size_t>(report.corners, 1)));
    }
    result_.rig.pairs = options_.pairs.empty() ? pairs_of_neighbours(result_.rig.cameras) : given_pairs();
    for (const capture::StereoPair& pair : result_.rig.pairs) {
      result_.pairs.push_back(report_of(pair));
    }
  }

  PairReport report_of(const capture::StereoPair& pair) const {
    PairReport report{.pair = pair};
    const capture::Lens& left = result_.rig.cameras[pair.left].lens;
    const capture::Lens& right = result_.rig.cameras[pair.right].lens;
    report.baseline_mm = (left.centre_mm() - right.centre_mm()).norm();
    report.angle_deg =
        angle_between(left.camera_from_rig.linear().row(2), right.camera_from_rig.linear().row(2));
    double squares = 0;
    for (std::size_t view = 0; view < views_.size(); ++view) {
      if (!used_[pair.left][view] || !used_[pair.right][view]) {
        continue;
      }
      const BoardView& a = seen(pair.left, view);
      const BoardView& b = seen(pair.right, view);
      for (std::size_t i = 0; i < a.ids.size(); ++i) {
        const auto at = std::find(b.ids.begin(), b.ids.end(), a.ids[i]);
        if (at == b.ids.end()) {
          continue;
        }
        const Eigen::Vector2d& other = b.px[static_cast<std::size_t>(at - b.ids.begin())];
        if (const auto error = capture::epipolar_error_px(left, right, {a.px[i], other})) {
          squares += *error * *error;
          ++report.corners;
        }
      }
    }
    report.epipolar_rms_px =
        std::sqrt(squares / static_cast<double>(std::max<std::size_t>(report.corners, 1)));
    return report;
  }

  const std::vector<Eigen::Vector3d> corners_;
  const Eigen::Vector3d centre_mm_;
  const std::vector<CalibrationCamera>& cameras_;
  const std::vector<CalibrationView>& views_;
  const CalibratorOptions& options_;
  const CalibrationProgress& progress_;
  std::vector<std::vector<bool>> used_;                            // [camera][view]
  std::vector<std::vector<Eigen::Isometry3d>> camera_from_board_;  // [camera][view], where used
  std::vector<capture::Lens> lenses_;     // camera_from_rig: from the first camera's frame
  std::vector<double> alone_px_;          // [camera]
  std::vector<std::size_t> joint_views_;  // of the problem's views, the index in views_
  Calibration result_;
};

}  // namespace

Calibration calibrate(const Board& board, const std::vector<CalibrationCamera>& cameras,
                      const std::vector<CalibrationView>& views, const CalibratorOptions& options,
                      const CalibrationProgress& progress) {
  check(board);
  if (cameras.empty()) {
    throw Error(ErrorKind::Usage, "there is no camera to calibrate");
  }
  return Calibrator(board, cameras, views, options, progress).run();
}

Eigen::Isometry3d mean_camera(const std::vector<capture::Lens>& lenses) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const capture::Lens& lens : lenses) {
    sum += lens.camera_from_rig.linear().transpose();
    centre += lens.centre_mm();
  }
  const auto count = static_cast<double>(lenses.size());
  // The rotation nearest to the sum: the chordal mean [HTDL13 sec. 5.3].
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum / count, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d turn = svd.matrixU() * svd.matrixV().transpose();
  if (turn.determinant() < 0) {
    turn = svd.matrixU() * Eigen::Vector3d(1, 1, -1).asDiagonal() * svd.matrixV().transpose();
  }
  constexpr double kLeast = 0.2;  // cameras that look the same way have singular values near 1
  if (lenses.size() == 1 || svd.singularValues()[1] + svd.singularValues()[2] < 2 * kLeast) {
    return lenses.front().camera_from_rig.inverse();
  }
  Eigen::Isometry3d world_from_rig = Eigen::Isometry3d::Identity();
  world_from_rig.linear() = turn;
  world_from_rig.translation() = centre / count;
  return world_from_rig;
}

std::vector<capture::StereoPair> pairs_of_neighbours(const std::vector<capture::RigCamera>& cameras) {
  const auto monochrome = std::count_if(cameras.begin(), cameras.end(),
                                        [](const capture::RigCamera& camera) { return !camera.colour; });
  constexpr double kMostAngle_deg = 60;
  struct Candidate {
    double distance_mm;
    std::size_t a;
    std::size_t b;
  };
  std::vector<Candidate> candidates;
  for (std::size_t b = 0; b < cameras.size(); ++b) {
    for (std::size_t a = 0; a < b; ++a) {
      const capture::Lens& first = cameras[a].lens;
      const capture::Lens& second = cameras[b].lens;
      if (monochrome >= 2 && (cameras[a].colour || cameras[b].colour)) {
        continue;
      }
      if (angle_between(first.camera_from_rig.linear().row(2), second.camera_from_rig.linear().row(2)) <=
          kMostAngle_deg) {
        candidates.push_back({(first.centre_mm() - second.centre_mm()).norm(), a, b});
      }
    }
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& one, const Candidate& other) { return one.distance_mm < other.distance_mm; });
  std::vector<bool> taken(cameras.size());
  std::vector<capture::StereoPair> pairs;
  for (const Candidate& candidate : candidates) {
    if (!taken[candidate.a] && !taken[candidate.b]) {
      taken[candidate.a] = taken[candidate.b] = true;
      const Eigen::Vector3d offset =
          cameras[candidate.a].lens.camera_from_rig * cameras[candidate.b].lens.centre_mm();
      const bool beside = std::abs(offset.x()) >= std::abs(offset.y());
      const bool first_is_left = beside ? offset.x() > 0 : offset.y() > 0;
      pairs.push_back(first_is_left ? capture::StereoPair{candidate.a, candidate.b}
                                    : capture::StereoPair{candidate.b, candidate.a});
    }
  }
  return pairs;
}

void Coverage::add(const BoardView& view) {
  for (const Eigen::Vector2d& px : view.px) {
    const int column = static_cast<int>(std::floor((px.x() + 0.5) / width_px_ * kColumns));
    const int row = static_cast<int>(std::floor((px.y() + 0.5) / height_px_ * kRows));
    if (column >= 0 && column < kColumns && row >= 0 && row < kRows) {
      ++counts_.at(static_cast<std::size_t>(row * kColumns + column));
    }
  }
}

double Coverage::part() const {
  return static_cast<double>(counts_.size() -
                             static_cast<std::size_t>(std::count(counts_.begin(), counts_.end(), 0))) /
         static_cast<double>(counts_.size());
}

}  // namespace facet::calibration
