#include "stereo_metrics.hpp"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "maths/statistics.hpp"

namespace facet::bench {

void DepthFigures::add(const StereoFootage& footage, std::size_t slot, const std::vector<float>& depth_mm) {
  const std::vector<float>& truth = footage.truth_mm[slot];
  const std::vector<bool>& seen = footage.seen[slot];
  const auto width = static_cast<std::size_t>(footage.width_px);
  for (std::size_t at = 0; at < truth.size(); ++at) {
    const bool has_depth = depth_mm[at] > 0;
    if (seen[at]) {
      ++seen_;
      if (has_depth) {
        errors_mm_.push_back(std::abs(depth_mm[at] - truth[at]));
      }
    } else if (has_depth && footage.nothing[slot][at]) {
      ++invented_;
    }
  }
  // Difference of a mean over 3 and a mean over 15 px: passes waves between 4 and 16 px.
  constexpr std::size_t reach = 7;
  for (int y = 0; y < footage.height_px; ++y) {
    const std::size_t first = static_cast<std::size_t>(y) * width;
    for (std::size_t x = reach; x + reach < width; ++x) {
      double narrow = 0;
      double wide = 0;
      double true_narrow = 0;
      double true_wide = 0;
      bool whole = true;
      for (std::size_t k = x - reach; k <= x + reach && whole; ++k) {
        const std::size_t at = first + k;
        whole = depth_mm[at] > 0 && seen[at];
        // Errors beyond 5 mm are outliers, which the percentiles count.
        const double error = static_cast<double>(depth_mm[at]) - static_cast<double>(truth[at]);
        whole = whole && std::abs(error) < 5;
        wide += error;
        const double deep = static_cast<double>(truth[at]);
        true_wide += deep;
        true_narrow += k + 1 >= x && k <= x + 1 ? deep : 0;
        narrow += k + 1 >= x && k <= x + 1 ? error : 0;
      }
      // Where the surface itself has such waves, missing detail would count as ridges.
      constexpr double most_detail_mm = 0.1;
      if (whole && std::abs(true_narrow / 3 - true_wide / (2 * reach + 1)) < most_detail_mm) {
        const double band = narrow / 3 - wide / (2 * reach + 1);
        band_square_ += band * band;
        ++band_count_;
      }
    }
  }
}

double DepthFigures::percentile_mm(double fraction) const {
  if (errors_mm_.empty()) {
    return 0;
  }
  const double place = fraction * static_cast<double>(errors_mm_.size() - 1);
  return static_cast<double>(maths::nth_of(errors_mm_, static_cast<std::size_t>(place)));
}

double DepthFigures::fill() const {
  return seen_ == 0 ? 0 : static_cast<double>(errors_mm_.size()) / static_cast<double>(seen_);
}
double DepthFigures::ridges_mm() const {
  return band_count_ == 0 ? 0 : std::sqrt(band_square_ / static_cast<double>(band_count_));
}

render::Picture relief(const StereoFootage& footage, const std::vector<float>& depth_mm) {
  render::Picture out = render::plain_picture(footage.width_px, footage.height_px, {30, 40, 90});
  const capture::Lens& lens = footage.lens;
  const auto point = [&](int x, int y) -> Eigen::Vector3d {
    const auto depth = static_cast<double>(
        depth_mm[static_cast<std::size_t>(y) * static_cast<std::size_t>(footage.width_px) +
                 static_cast<std::size_t>(x)]);
    return depth * Eigen::Vector3d((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1);
  };
  const Eigen::Vector3d light = Eigen::Vector3d(-1, -0.8, -1).normalized();
  for (int y = 0; y + 1 < footage.height_px; ++y) {
    for (int x = 0; x + 1 < footage.width_px; ++x) {
      const Eigen::Vector3d own = point(x, y);
      const Eigen::Vector3d right = point(x + 1, y);
      const Eigen::Vector3d below = point(x, y + 1);
      if (own.z() > 0 && right.z() > 0 && below.z() > 0) {
        const Eigen::Vector3d normal = (below - own).cross(right - own).normalized();
        const double shade = std::clamp(0.1 + 0.9 * std::abs(normal.dot(light)), 0.0, 1.0);
        const std::size_t at = 3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(footage.width_px) +
                                    static_cast<std::size_t>(x));
        std::fill_n(out.rgb.begin() + static_cast<std::ptrdiff_t>(at), 3,
                    render::linear_to_srgb8(static_cast<float>(shade * shade)));
      }
    }
  }
  return out;
}

render::Picture error_picture(const StereoFootage& footage, std::size_t slot,
                              const std::vector<float>& depth_mm) {
  render::Picture out = render::plain_picture(footage.width_px, footage.height_px, {90, 90, 90});
  const std::vector<float>& truth = footage.truth_mm[slot];
  for (std::size_t at = 0; at < truth.size(); ++at) {
    const float error = std::abs(depth_mm[at] - truth[at]);
    std::array<std::uint8_t, 3> colour{90, 90, 90};
    if (footage.seen[slot][at]) {
      colour = depth_mm[at] > 0 ? render::heat_colour(error) : std::array<std::uint8_t, 3>{255, 255, 255};
    } else if (depth_mm[at] > 0 && footage.nothing[slot][at]) {
      colour = {255, 0, 0};
    }
    std::copy(colour.begin(), colour.end(), out.rgb.begin() + static_cast<std::ptrdiff_t>(3 * at));
  }
  return out;
}

}  // namespace facet::bench
