#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "mesh/mesh_frame.hpp"

namespace facet::report {

/// How one expression's weight follows the true one. NaN where it can't be said.
struct WeightFigures {
  std::string name;        ///< as the take has it
  bool moves = false;      ///< whether the true weight does: its standard deviation is above kMoves
  bool is_dead = false;    ///< the take's does not move, though the true one does
  double correlation = 0;  ///< Pearson's; NaN where one of the two does not move
  double slope = 0;  ///< of the regression of the take's weight on the true one; NaN where that does not move
  double mean_error = 0;   ///< mean of |take's - true|
  double rest_offset = 0;  ///< mean of the take's where the true one is below kRests; NaN where it never is

  static constexpr double kMoves = 0.02;
  static constexpr double kRests = 0.02;
};

/// Those that move, in one line.
struct WeightSummary {
  int moving = 0;
  int well = 0;    ///< correlate by 0.9 or more
  int fairly = 0;  ///< by 0.65 or more
  int dead = 0;
  double median_slope = 0;
  double mean_error = 0;
};

/// Gathers a take's and the true weights, by ARKit's names whatever their first letter's case. One thread.
class ExpressionSum {
 public:
  /// names, expression   [expression_count] of the take's frame
  /// truth               by name; a frame without is not counted
  void add(const std::vector<std::string>& names, const std::vector<float>& expression,
           const std::map<std::string, float>& truth);

  /// By name; those that both know.
  std::vector<WeightFigures> figures() const;

 private:
  struct Course {
    std::vector<double> truth;
    std::vector<double> estimate;
  };
  std::map<std::string, Course> courses_;
};

WeightSummary summary_of(const std::vector<WeightFigures>& figures);

/// How the head's pose follows the true one, once the constant shift and turn between the two head frames is
/// taken out. NaN without poses.
struct PoseFigures {
  int frames = 0;
  double rotation_deg = 0;  ///< mean
  double rotation_p95_deg = 0;
  double translation_mm = 0;  ///< mean
  double translation_p95_mm = 0;
  double depth_mm = 0;       ///< mean of the part along the camera's z axis
  double focal_percent = 0;  ///< mean of the take's focal length over the true one, minus 1
};

/// Gathers poses and focal lengths. One thread.
class PoseSum {
 public:
  void add_pose(const Eigen::Isometry3f& camera_from_head, const Eigen::Isometry3f& true_camera_from_head);
  void add_focal_length(float px, float true_px);
  PoseFigures figures() const;

 private:
  std::vector<Eigen::Isometry3d> estimates_;
  std::vector<Eigen::Isometry3d> truths_;
  double sum_focal_ = 0;
  int focal_count_ = 0;
};

}  // namespace facet::report
