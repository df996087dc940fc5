#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "calibration/board.hpp"
#include "calibration/bundle.hpp"
#include "capture/rig.hpp"

namespace facet::calibration {

struct CalibrationCamera {
  std::string name;
  int width_px = 0;
  int height_px = 0;
  bool colour = false;
};

/// One moment: what every camera saw of the board.
struct CalibrationView {
  std::string name;             ///< as messages call it
  std::vector<BoardView> seen;  ///< [camera_count]
};

struct CalibratorOptions {
  int least_views = 8;           ///< of each camera
  double most_oblique_deg = 70;  ///< between the board's normal and the line of sight
  double most_error_px = 0.5;    ///< a picture whose error is above this and
  double most_error_factor = 3;  ///< above this many times the median of its camera is an outlier
  bool free_k3 = false;          ///< a third radial coefficient, for wide lenses
  /// Names of the left and the right camera; where empty, monochrome cameras next to one another.
  std::vector<std::pair<std::string, std::string>> pairs;
};

struct RejectedPicture {
  std::string view;
  std::string camera;
  std::string reason;
};

/// What remains of one corner in one picture once all is fitted.
struct CornerError {
  std::size_t camera = 0;
  std::size_t view = 0;
  Eigen::Vector2d px;        ///< where it was seen
  Eigen::Vector2d error_px;  ///< where the model puts it, minus that
};

struct CameraReport {
  std::string name;
  std::size_t views = 0;
  std::size_t corners = 0;
  double rms_px = 0;                            ///< reprojection error, sqrt(mean of dx^2 + dy^2)
  std::array<double, kIntrinsicCount> sigma{};  ///< standard deviations, as in BundleResult
  double largest_tilt_deg = 0;                  ///< between the normals of two views' boards
};

struct PairReport {
  capture::StereoPair pair;
  std::size_t corners = 0;  ///< seen by both
  double epipolar_rms_px = 0;
  double baseline_mm = 0;
  double angle_deg = 0;  ///< between the viewing directions
};

struct Calibration {
  capture::Rig rig;
  std::vector<CameraReport> cameras;
  std::vector<PairReport> pairs;
  std::vector<RejectedPicture> rejected;
  std::vector<CornerError> errors;
  double rms_px = 0;
  std::size_t views = 0;
};

/// Called with what is being done, the step and the number of steps.
using CalibrationProgress = std::function<void(const std::string& what, std::size_t done, std::size_t total)>;

/// Finds intrinsics, distortion and poses of all cameras from views of a board: first every camera alone,
/// then all in one adjustment. Pictures that are too oblique or do not fit are left out and named. The rig's
/// frame is the mean camera (mean_camera()). Throws Error(UnreadableInput) with the camera and what to do
/// where the views do not tell: too few, all parallel (the focal length can't be seen), cameras that never
/// see the board together, cameras that disagree about where it was; Error(Usage) for pairs that are none.
Calibration calibrate(const Board& board, const std::vector<CalibrationCamera>& cameras,
                      const std::vector<CalibrationView>& views, const CalibratorOptions& options,
                      const CalibrationProgress& progress = {});

/// The frame that a rig's numbers are given in: the origin in the middle of the cameras, the axes the
/// rotation closest to the mean of theirs (x right, y down, z forward). It does not depend on where the board
/// was. The first camera's frame where the cameras have no mean direction (all around the subject).
Eigen::Isometry3d mean_camera(const std::vector<capture::Lens>& lenses);

/// Pairs of neighbouring cameras that look the same way within 60 degrees, closest first, each camera in one
/// pair at most; monochrome ones only where there are two or more.
std::vector<capture::StereoPair> pairs_of_neighbours(const std::vector<capture::RigCamera>& cameras);

/// Which cells of a picture corners were seen in, counted.
class Coverage {
 public:
  static constexpr int kColumns = 8;
  static constexpr int kRows = 6;
  Coverage(int width_px, int height_px) : width_px_(width_px), height_px_(height_px) {}
  void add(const BoardView& view);
  /// The part of the cells where a corner was seen, 0 to 1.
  double part() const;
  int count(int column, int row) const {
    return counts_.at(static_cast<std::size_t>(row * kColumns + column));
  }
  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }

 private:
  int width_px_;
  int height_px_;
  std::array<int, std::size_t{kColumns} * kRows> counts_{};
};

}  // namespace facet::calibration
