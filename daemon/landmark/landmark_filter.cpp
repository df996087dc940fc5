#include "landmark/landmark_filter.hpp"

#include "landmark/low_pass.hpp"

namespace facet::landmark {
namespace {

constexpr float resting_cutoff_hz = 2.0F;
constexpr float cutoff_hz_per_speed = 120.0F;  ///< speed in interocular distances per second
constexpr float velocity_cutoff_hz = 3.0F;

}  // namespace

void LandmarkFilter::apply(float interocular_px, float seconds, Eigen::Matrix3Xf& points_px) {
  if (!started_) {
    started_ = true;
    measured_ = points_px;
    filtered_ = points_px;
    velocity_.setZero(2, points_px.cols());
    return;
  }
  const float velocity_share = new_share(velocity_cutoff_hz, seconds);
  const float per_second = 1 / (interocular_px * seconds);
  for (Eigen::Index i = 0; i < points_px.cols(); ++i) {
    const Eigen::Vector2f speed = per_second * (points_px.col(i) - measured_.col(i)).head<2>();
    velocity_.col(i) += velocity_share * (speed - velocity_.col(i));
    const float cutoff_hz = resting_cutoff_hz + cutoff_hz_per_speed * velocity_.col(i).norm();
    filtered_.col(i) += new_share(cutoff_hz, seconds) * (points_px.col(i) - filtered_.col(i));
  }
  measured_ = points_px;
  points_px = filtered_;
}

}  // namespace facet::landmark
