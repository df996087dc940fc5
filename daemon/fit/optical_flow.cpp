#include "fit/optical_flow.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "facet/error.hpp"

namespace facet::fit {

namespace {

constexpr float kTripLimitPx = 1;
constexpr int kLeastSidePx = 64;

void to_grey(const Frame& frame, const cv::Rect& box, cv::Mat& grey) {
  const cv::Mat rgba(frame.height_px, frame.width_px, CV_8UC4, const_cast<std::uint8_t*>(frame.row(0)),
                     frame.stride_bytes);
  cv::cvtColor(rgba(box), grey, cv::COLOR_RGBA2GRAY);
}

/// One side of a box within a picture's, as long as is asked for at least.
void fit_side(int& from, int& length, int whole) {
  const int wanted = std::min(whole, std::max(length, kLeastSidePx));
  from = std::clamp(from - (wanted - length) / 2, 0, whole - wanted);
  length = wanted;
}

}  // namespace

struct OpticalFlow::Impl {
  cv::Ptr<cv::DISOpticalFlow>
      dis;  ///< for pictures of `size` alone: OpenCV 4.6's ends in its own stale buffers
  cv::Size size;
  cv::Mat earlier, later, there, back;
};

OpticalFlow::OpticalFlow() : impl_(std::make_unique<Impl>()) {}
OpticalFlow::~OpticalFlow() = default;

void OpticalFlow::find(const Frame& earlier, const Frame& later, const PixelBox& box, Flow& out) {
  if (earlier.empty() || later.empty() || earlier.width_px != later.width_px ||
      earlier.height_px != later.height_px) {
    throw Error(ErrorKind::Usage,
                fmt::format("optical flow needs two pictures of one size, not {}x{} and {}x{}",
                            earlier.width_px, earlier.height_px, later.width_px, later.height_px));
  }
  cv::Rect part(box.left, box.top, box.width, box.height);
  fit_side(part.x, part.width, earlier.width_px);
  fit_side(part.y, part.height, earlier.height_px);
  to_grey(earlier, part, impl_->earlier);
  to_grey(later, part, impl_->later);
  if (impl_->dis == nullptr || impl_->size != part.size()) {
    impl_->dis = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
    // Down to whole pixels: where a mouth corner moves quickly the preset's half pixels are wrong by one and
    // a half, and correspondence is lost there.
    impl_->dis->setFinestScale(0);
    impl_->size = part.size();
  }
  impl_->dis->calc(impl_->earlier, impl_->later, impl_->there);
  impl_->dis->calc(impl_->later, impl_->earlier, impl_->back);
  const auto width = static_cast<std::size_t>(earlier.width_px);
  out.width_px = earlier.width_px;
  out.height_px = earlier.height_px;
  out.flow_px.assign(width * static_cast<std::size_t>(earlier.height_px), Eigen::Vector2f(0, 0));
  out.confidence.assign(out.flow_px.size(), 0);
  for (int y = 0; y < part.height; ++y) {
    const auto* there = impl_->there.ptr<cv::Vec2f>(y);
    const std::size_t row = static_cast<std::size_t>(part.y + y) * width + static_cast<std::size_t>(part.x);
    for (int x = 0; x < part.width; ++x) {
      const std::size_t at = row + static_cast<std::size_t>(x);
      const Eigen::Vector2f forth(there[x][0], there[x][1]);
      out.flow_px[at] = forth;
      const float to_x = static_cast<float>(x) + forth.x();
      const float to_y = static_cast<float>(y) + forth.y();
      if (!(to_x >= 0 && to_y >= 0 && to_x < static_cast<float>(part.width - 1) &&
            to_y < static_cast<float>(part.height - 1))) {
        continue;
      }
      const int left = static_cast<int>(to_x);
      const int top = static_cast<int>(to_y);
      const float u = to_x - static_cast<float>(left);
      const float v = to_y - static_cast<float>(top);
      const auto* upper = impl_->back.ptr<cv::Vec2f>(top);
      const auto* lower = impl_->back.ptr<cv::Vec2f>(top + 1);
      const cv::Vec2f again = (upper[left] * (1 - u) + upper[left + 1] * u) * (1 - v) +
                              (lower[left] * (1 - u) + lower[left + 1] * u) * v;
      const float trip = (forth + Eigen::Vector2f(again[0], again[1])).norm();
      out.confidence[at] = std::max(0.0F, 1 - trip / kTripLimitPx);
    }
  }
}

}  // namespace facet::fit
