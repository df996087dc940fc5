#include "report/tracking_figures.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "maths/statistics.hpp"
#include "mesh/arkit.hpp"

namespace facet::report {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

double mean_of(const std::vector<double>& values) {
  return values.empty()
             ? kNone
             : std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

/// Mean of the products of what two courses differ from their means.
double covariance(const std::vector<double>& one, const std::vector<double>& other) {
  const double mean = mean_of(one);
  const double other_mean = mean_of(other);
  double sum = 0;
  for (std::size_t k = 0; k < one.size(); ++k) {
    sum += (one[k] - mean) * (other[k] - other_mean);
  }
  return sum / static_cast<double>(one.size());
}

/// ARKit's spelling where it is one of its names, also with _L and _R for its sides, else as it is.
std::string common_name(std::string name) {
  if (name.ends_with("_L") || name.ends_with("_R")) {
    name.replace(name.size() - 2, 2, name.back() == 'L' ? "Left" : "Right");
  }
  const int index = mesh::arkit_index(name);
  return index < 0 ? name : mesh::arkit_name(static_cast<std::size_t>(index));
}

WeightFigures figures_of(const std::string& name, const std::vector<double>& truth,
                         const std::vector<double>& estimate) {
  WeightFigures out;
  out.name = name;
  const double true_variance = covariance(truth, truth);
  const double variance = covariance(estimate, estimate);
  constexpr double kStill = 0.002;  // a standard deviation below which a weight may be called still
  out.moves = std::sqrt(true_variance) > WeightFigures::kMoves;
  out.is_dead = out.moves && std::sqrt(variance) < kStill;
  const double product = covariance(truth, estimate);
  out.correlation = out.moves && !out.is_dead ? product / std::sqrt(true_variance * variance) : kNone;
  out.slope = out.moves ? product / true_variance : kNone;
  std::vector<double> errors;
  std::vector<double> at_rest;
  for (std::size_t k = 0; k < truth.size(); ++k) {
    errors.push_back(std::abs(estimate[k] - truth[k]));
    if (truth[k] < WeightFigures::kRests) {
      at_rest.push_back(estimate[k]);
    }
  }
  out.mean_error = mean_of(errors);
  out.rest_offset = mean_of(at_rest);
  return out;
}

/// The rotation that is nearest to all of them: the eigenvector of the sum of q q^T with the largest value.
Eigen::Quaterniond mean_rotation(const std::vector<Eigen::Isometry3d>& poses) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (const Eigen::Isometry3d& pose : poses) {
    const Eigen::Vector4d q = Eigen::Quaterniond(pose.linear()).coeffs();
    sum += q * q.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(sum);
  return Eigen::Quaterniond(Eigen::Vector4d(solver.eigenvectors().col(3)));
}

}  // namespace

void ExpressionSum::add(const std::vector<std::string>& names, const std::vector<float>& expression,
                        const std::map<std::string, float>& truth) {
  std::map<std::string, float> true_weights;
  for (const auto& [name, weight] : truth) {
    true_weights[common_name(name)] = weight;
  }
  for (std::size_t e = 0; e < std::min(names.size(), expression.size()); ++e) {
    const auto found = true_weights.find(common_name(names[e]));
    if (found != true_weights.end()) {
      Course& course = courses_[names[e]];
      course.truth.push_back(static_cast<double>(found->second));
      course.estimate.push_back(static_cast<double>(expression[e]));
    }
  }
}

std::vector<WeightFigures> ExpressionSum::figures() const {
  std::vector<WeightFigures> figures;
  for (const auto& [name, course] : courses_) {
    figures.push_back(figures_of(name, course.truth, course.estimate));
  }
  return figures;
}

WeightSummary summary_of(const std::vector<WeightFigures>& figures) {
  constexpr double kWell = 0.9;
  constexpr double kFairly = 0.65;
  WeightSummary summary;
  std::vector<double> slopes;
  std::vector<double> errors;
  for (const WeightFigures& one : figures) {
    if (!one.moves) {
      continue;
    }
    ++summary.moving;
    summary.well += one.correlation >= kWell ? 1 : 0;
    summary.fairly += one.correlation >= kFairly ? 1 : 0;
    summary.dead += one.is_dead ? 1 : 0;
    slopes.push_back(one.slope);
    errors.push_back(one.mean_error);
  }
  summary.median_slope = slopes.empty() ? kNone : maths::median_of(slopes);
  summary.mean_error = mean_of(errors);
  return summary;
}

void PoseSum::add_pose(const Eigen::Isometry3f& camera_from_head,
                       const Eigen::Isometry3f& true_camera_from_head) {
  estimates_.push_back(camera_from_head.cast<double>());
  truths_.push_back(true_camera_from_head.cast<double>());
}

void PoseSum::add_focal_length(float px, float true_px) {
  sum_focal_ += static_cast<double>(px) / static_cast<double>(true_px) - 1;
  ++focal_count_;
}

PoseFigures PoseSum::figures() const {
  constexpr double kPercent = 100;
  const double focal = focal_count_ > 0 ? kPercent * sum_focal_ / focal_count_ : kNone;
  if (estimates_.empty()) {
    return {0, kNone, kNone, kNone, kNone, kNone, focal};
  }
  // What lies between the head frames, frame by frame, and its mean.
  std::vector<Eigen::Isometry3d> between;
  Eigen::Vector3d shift_mm = Eigen::Vector3d::Zero();
  for (std::size_t k = 0; k < estimates_.size(); ++k) {
    between.push_back(truths_[k].inverse() * estimates_[k]);
    shift_mm += between.back().translation() / static_cast<double>(estimates_.size());
  }
  Eigen::Isometry3d constant = Eigen::Isometry3d::Identity();
  constant.linear() = mean_rotation(between).toRotationMatrix();
  constant.translation() = shift_mm;

  std::vector<double> turns_deg;
  std::vector<double> shifts_mm;
  std::vector<double> depths_mm;
  for (std::size_t k = 0; k < estimates_.size(); ++k) {
    const Eigen::Isometry3d expected = truths_[k] * constant;
    const Eigen::AngleAxisd turn(expected.linear().transpose() * estimates_[k].linear());
    turns_deg.push_back(std::abs(turn.angle()) * 180 / std::numbers::pi);
    const Eigen::Vector3d off_mm = estimates_[k].translation() - expected.translation();
    shifts_mm.push_back(off_mm.norm());
    depths_mm.push_back(std::abs(off_mm.z()));
  }
  constexpr double kMost = 0.95;
  PoseFigures figures;
  figures.frames = static_cast<int>(estimates_.size());
  figures.rotation_deg = mean_of(turns_deg);
  figures.rotation_p95_deg = maths::quantile_of(turns_deg, kMost);
  figures.translation_mm = mean_of(shifts_mm);
  figures.translation_p95_mm = maths::quantile_of(shifts_mm, kMost);
  figures.depth_mm = mean_of(depths_mm);
  figures.focal_percent = focal;
  return figures;
}

}  // namespace facet::report
