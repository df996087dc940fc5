#include "track/depth_filter.hpp"

#include <cmath>

#include "landmark/low_pass.hpp"

namespace facet::track {
namespace {

constexpr double resting_cutoff_hz = 1;
constexpr double cutoff_hz_per_mm_s = 0.15;  ///< so a steadily moving head is at most 1.1 mm behind
constexpr double velocity_cutoff_hz = 2;

}  // namespace

double DepthFilter::apply(double depth_mm, double seconds) {
  if (!started_) {
    started_ = true;
    measured_mm_ = depth_mm;
    filtered_mm_ = depth_mm;
    velocity_mm_s_ = 0;
    return depth_mm;
  }
  velocity_mm_s_ += landmark::new_share(velocity_cutoff_hz, seconds) *
                    ((depth_mm - measured_mm_) / seconds - velocity_mm_s_);
  measured_mm_ = depth_mm;
  const double cutoff_hz = resting_cutoff_hz + cutoff_hz_per_mm_s * std::abs(velocity_mm_s_);
  filtered_mm_ += landmark::new_share(cutoff_hz, seconds) * (depth_mm - filtered_mm_);
  return filtered_mm_;
}

}  // namespace facet::track
