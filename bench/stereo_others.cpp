#include "stereo_others.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "render/renderer.hpp"
#include "stereo_metrics.hpp"

namespace facet::bench {
namespace {

cv::Mat grey_of(const Frame& frame, const std::vector<Eigen::Vector2f>& sources, int width, int height) {
  const cv::Mat rgba(frame.height_px, frame.width_px, CV_8UC4, const_cast<std::uint8_t*>(frame.pixels.get()),
                     frame.stride_bytes);
  cv::Mat grey;
  cv::extractChannel(rgba, grey, 1);
  cv::Mat map(height, width, CV_32FC2);
  std::copy_n(reinterpret_cast<const float*>(sources.data()), 2 * sources.size(), map.ptr<float>());
  cv::Mat out;
  cv::remap(grey, out, map, cv::noArray(), cv::INTER_CUBIC, cv::BORDER_CONSTANT, 0);
  return out;
}

struct Rectified {
  stereo::Rectification rectification;
  std::vector<cv::Mat> left, right;  ///< [slots] empty for blank slots

  explicit Rectified(const StereoFootage& footage) : rectification(footage.rectification()) {
    const auto left_sources = rectification.left_sources();
    const auto right_sources = rectification.right_sources();
    for (const stereo::StereoSlot& slot : footage.slots) {
      const bool used = slot.has_pattern;
      left.push_back(used ? grey_of(slot.left, left_sources, footage.width_px, footage.height_px)
                          : cv::Mat());
      right.push_back(used ? grey_of(slot.right, right_sources, footage.width_px, footage.height_px)
                           : cv::Mat());
    }
  }
};

}  // namespace

std::vector<std::vector<float>> match_windows(const StereoFootage& footage) {
  const Rectified pictures(footage);
  const int width = footage.width_px;
  const int height = footage.height_px;
  const int least = pictures.rectification.least_disparity_px();
  const int most = pictures.rectification.most_disparity_px();
  const auto count = static_cast<std::size_t>(most - least + 1);
  const cv::Size window(9, 5);
  std::vector<std::vector<float>> out(footage.slots.size());
  for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
    if (pictures.left[slot].empty()) {
      continue;
    }
    cv::Mat left, right;
    pictures.left[slot].convertTo(left, CV_32F, 1 / 255.0);
    pictures.right[slot].convertTo(right, CV_32F, 1 / 255.0);
    cv::Mat left_mean, left_square;
    cv::blur(left, left_mean, window);
    cv::blur(left.mul(left), left_square, window);
    const cv::Mat left_variance = left_square - left_mean.mul(left_mean);
    std::vector<cv::Mat> errors(count);
    for (std::size_t k = 0; k < count; ++k) {
      const int d = least + static_cast<int>(k);
      cv::Mat moved(height, width, CV_32F, cv::Scalar(0));
      const int from = std::max(0, d);
      const int past = std::min(width, width + d);
      if (from < past) {
        right.colRange(from - d, past - d).copyTo(moved.colRange(from, past));
      }
      cv::Mat mean, square, mixed;
      cv::blur(moved, mean, window);
      cv::blur(moved.mul(moved), square, window);
      cv::blur(left.mul(moved), mixed, window);
      const cv::Mat covariance = cv::max(mixed - left_mean.mul(mean), 0);
      const cv::Mat variance = square - mean.mul(mean) + 1e-6;
      // What is left of the left window after the right one's best gain and bias.
      errors[k] = left_variance - covariance.mul(covariance) / variance;
    }
    std::vector<float>& depth = out[slot];
    depth.assign(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 0.0F);
    std::vector<float> right_error(static_cast<std::size_t>(width));
    std::vector<std::size_t> right_best(static_cast<std::size_t>(width));
    for (int y = 0; y < height; ++y) {
      std::fill(right_error.begin(), right_error.end(), std::numeric_limits<float>::max());
      for (int x = 0; x < width; ++x) {
        for (std::size_t k = 0; k < count; ++k) {
          const int there = x - least - static_cast<int>(k);
          if (there >= 0 && there < width &&
              errors[k].at<float>(y, x) < right_error[static_cast<std::size_t>(there)]) {
            right_error[static_cast<std::size_t>(there)] = errors[k].at<float>(y, x);
            right_best[static_cast<std::size_t>(there)] = k;
          }
        }
      }
      for (int x = 0; x < width; ++x) {
        if (left_variance.at<float>(y, x) < 1e-4F) {
          continue;
        }
        std::size_t best = 0;
        for (std::size_t k = 1; k < count; ++k) {
          best = errors[k].at<float>(y, x) < errors[best].at<float>(y, x) ? k : best;
        }
        const int there = x - least - static_cast<int>(best);
        if (best == 0 || best + 1 == count || there < 0 || there >= width ||
            std::abs(static_cast<int>(right_best[static_cast<std::size_t>(there)]) - static_cast<int>(best)) >
                1 ||
            errors[best].at<float>(y, x) > 0.5F * left_variance.at<float>(y, x)) {
          continue;
        }
        const float before = errors[best - 1].at<float>(y, x);
        const float own = errors[best].at<float>(y, x);
        const float after = errors[best + 1].at<float>(y, x);
        const float bend = before - 2 * own + after;
        const float fraction = bend > 0 ? (before - after) / (2 * bend) : 0;
        depth[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] =
            static_cast<float>(pictures.rectification.depth_mm(least + static_cast<double>(best) +
                                                               static_cast<double>(fraction)));
      }
    }
  }
  return out;
}

namespace {

/// Of a window's pixels, seen through the disparity p . (1, x, y, t).
struct WindowSums {
  Eigen::Matrix4d m = Eigen::Matrix4d::Zero();   ///< slope^2 v v^T
  Eigen::Vector4d h = Eigen::Vector4d::Zero();   ///< slope v
  Eigen::Vector4d hw = Eigen::Vector4d::Zero();  ///< slope there v
  Eigen::Vector4d hl = Eigen::Vector4d::Zero();  ///< slope own v
  double n = 0, l = 0, w = 0, ll = 0, lw = 0, ww = 0;
};

WindowSums sums_of(const stereo::StereoMatcher& matcher, const stereo::SpacetimeOptions& options,
                   const stereo::VolumeSize& size, const std::array<int, 3>& centre,
                   const Eigen::Vector4d& p) {
  const auto [x0, y0, t0] = centre;
  const auto [width, height, slots] = size;
  const std::span<const float> left = matcher.left_grey();
  const std::span<const float> right = matcher.right_grey();
  const int rx = options.window_x / 2;
  const int ry = options.window_y / 2;
  const int rt = options.window_t / 2;
  WindowSums sums;
  auto& [m, h, hw, hl, n, l, w, ll, lw, ww] = sums;
  for (int t = std::max(0, t0 - rt); t <= std::min(slots - 1, t0 + rt); ++t) {
    for (int y = std::max(0, y0 - ry); y <= std::min(height - 1, y0 + ry); ++y) {
      const std::size_t row = size.voxel(0, y, t);
      for (int x = std::max(1, x0 - rx); x <= std::min(width - 2, x0 + rx); ++x) {
        const Eigen::Vector4d v(1, x - x0, y - y0, t - t0);
        const double from = x - p.dot(v);
        const double corner = std::floor(from);
        if (!(corner >= 1 && corner + 2 < width)) {
          continue;
        }
        const double f = from - corner;
        const float* r = right.data() + row + static_cast<std::size_t>(corner) - 1;
        const float* o = left.data() + row + static_cast<std::size_t>(x) - 1;
        if (std::min({r[0], r[1], r[2], r[3], o[0], o[1], o[2]}) < 0) {
          continue;
        }
        const double own =
            (static_cast<double>(o[0]) + 4 * static_cast<double>(o[1]) + static_cast<double>(o[2])) / 6;
        const double f2 = f * f;
        const double f3 = f2 * f;
        const Eigen::Vector4d taps = Eigen::Map<const Eigen::Vector4f>(r).cast<double>();
        const double there = taps.dot(Eigen::Vector4d(1 - 3 * f + 3 * f2 - f3, 4 - 6 * f2 + 3 * f3,
                                                      1 + 3 * f + 3 * f2 - 3 * f3, f3)) /
                             6;
        const double slope =
            -taps.dot(Eigen::Vector4d(-1 + 2 * f - f2, -4 * f + 3 * f2, 1 + 2 * f - 3 * f2, f2)) / 2;
        n += 1;
        l += own;
        w += there;
        ll += own * own;
        lw += own * there;
        ww += there * there;
        h += slope * v;
        hw += slope * there * v;
        hl += slope * own * v;
        m += slope * slope * v * v.transpose();
      }
    }
  }
  return sums;
}

}  // namespace

std::vector<std::vector<float>> match_local_direct(const StereoFootage& footage,
                                                   const stereo::StereoMatcher& matcher,
                                                   const stereo::SpacetimeOptions& options) {
  const int width = footage.width_px;
  const int height = footage.height_px;
  const auto slots = static_cast<int>(footage.slots.size());
  const stereo::VolumeSize size{width, height, slots};
  const std::span<const float> start = matcher.start_px();

  const auto solve = [&](int x0, int y0, int t0) -> float {
    const float first = start[size.voxel(x0, y0, t0)];
    if (std::isnan(first)) {
      return 0;
    }
    Eigen::Vector4d p(static_cast<double>(first), 0, 0, 0);
    for (int step = 0; step < 2 * options.steps; ++step) {
      const WindowSums sums = sums_of(matcher, options, size, {x0, y0, t0}, p);
      const auto& [m, h, hw, hl, n, l, w, ll, lw, ww] = sums;
      if (2 * n < options.window_x * options.window_y) {
        return 0;
      }
      const double c_lw = lw - l * w / n;
      const double c_ww = ww - w * w / n;
      const double c_ll = ll - l * l / n;
      if (c_lw <= 0 || c_ww <= 0) {
        return 0;
      }
      const double gain = c_lw / c_ww;
      const double variance =
          std::max(c_ll - gain * c_lw, 0.0) / n + static_cast<double>(options.noise * options.noise);
      const Eigen::Vector4d hwc = hw - w / n * h;
      const Eigen::Vector4d hlc = hl - l / n * h;
      const Eigen::Matrix4d hessian =
          gain * gain / variance * (m - h * h.transpose() / n - hwc * hwc.transpose() / c_ww) +
          static_cast<double>(options.damping) * Eigen::Matrix4d::Identity();
      const Eigen::Vector4d move = hessian.ldlt().solve(gain / variance * (hlc - gain * hwc));
      p[0] += std::clamp(move[0], -1.0, 1.0);
      p.tail<3>() += move.tail<3>().cwiseMax(-0.5).cwiseMin(0.5);
      if (std::abs(move[0]) < 1e-4) {
        break;
      }
    }
    return std::abs(p[0] - static_cast<double>(first)) < 2 ? static_cast<float>(p[0]) : 0;
  };

  std::vector<std::vector<float>> out(footage.slots.size());
  for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
    out[slot].assign(size.slot_voxels(), 0.0F);
    render::for_each_row(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        const float d = solve(x, y, static_cast<int>(slot));
        out[slot][size.voxel(x, y, 0)] =
            d == 0 ? 0 : static_cast<float>(matcher.rectification().depth_mm(static_cast<double>(d)));
      }
    });
  }
  return out;
}

std::vector<std::vector<float>> match_sgbm(const StereoFootage& footage) {
  const Rectified pictures(footage);
  const int width = footage.width_px;
  const int least = pictures.rectification.least_disparity_px();
  const int count = (pictures.rectification.most_disparity_px() - least + 16) / 16 * 16;
  std::vector<std::vector<float>> best;
  double best_median = std::numeric_limits<double>::max();
  std::string chosen;
  for (const int block : {3, 5, 7, 9}) {
    for (const int smooth : {2, 8, 24}) {
      for (const int mode : {cv::StereoSGBM::MODE_SGBM, cv::StereoSGBM::MODE_HH}) {
        const cv::Ptr<cv::StereoSGBM> matcher = cv::StereoSGBM::create(
            least, count, block, smooth * block * block, 4 * smooth * block * block, 1, 31, 5, 100, 2, mode);
        std::vector<std::vector<float>> maps(footage.slots.size());
        DepthFigures figures;
        for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
          if (pictures.left[slot].empty()) {
            continue;
          }
          // It looks at no pixel nearer to the picture's side than the largest disparity.
          const int margin = std::max(0, least + count);
          const int margin_after = std::max(0, -least);
          cv::Mat left, right, disparity;
          cv::copyMakeBorder(pictures.left[slot], left, 0, 0, margin, margin_after, cv::BORDER_REPLICATE);
          cv::copyMakeBorder(pictures.right[slot], right, 0, 0, margin, margin_after, cv::BORDER_REPLICATE);
          matcher->compute(left, right, disparity);
          std::vector<float>& depth = maps[slot];
          depth.assign(footage.truth_mm[slot].size(), 0.0F);
          for (int y = 0; y < footage.height_px; ++y) {
            for (int x = 0; x < width; ++x) {
              const auto value = disparity.at<std::int16_t>(y, x + margin);
              if (value > (least - 1) * 16) {
                depth[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                      static_cast<std::size_t>(x)] =
                    static_cast<float>(pictures.rectification.depth_mm(value / 16.0));
              }
            }
          }
          figures.add(footage, slot, depth);
        }
        if (!figures.empty() && figures.fill() > 0.8 && figures.percentile_mm(0.5) < best_median) {
          best_median = figures.percentile_mm(0.5);
          best = std::move(maps);
          chosen = fmt::format("block {}, P1 {} per pixel, {}", block, smooth,
                               mode == cv::StereoSGBM::MODE_HH ? "8 paths" : "5 paths");
        }
      }
    }
  }
  fmt::print("\n{} StereoSGBM: {}\n", footage.name, chosen);
  return best;
}

}  // namespace facet::bench
