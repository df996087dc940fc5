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

void to_grey(const Frame& frame, cv::Mat& grey) {
  const cv::Mat rgba(frame.height_px, frame.width_px, CV_8UC4, const_cast<std::uint8_t*>(frame.row(0)),
                     frame.stride_bytes);
  cv::cvtColor(rgba, grey, cv::COLOR_RGBA2GRAY);
}

}  // namespace

struct OpticalFlow::Impl {
  cv::Ptr<cv::DISOpticalFlow> dis = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
  cv::Mat earlier, later, there, back;
};

OpticalFlow::OpticalFlow() : impl_(std::make_unique<Impl>()) {
  // Down to whole pixels: where a mouth corner moves quickly the preset's half pixels are wrong by one and a
  // half, and correspondence is lost there.
  impl_->dis->setFinestScale(0);
}
OpticalFlow::~OpticalFlow() = default;

void OpticalFlow::find(const Frame& earlier, const Frame& later, Flow& out) {
  if (earlier.empty() || later.empty() || earlier.width_px != later.width_px ||
      earlier.height_px != later.height_px) {
    throw Error(ErrorKind::Usage,
                fmt::format("optical flow needs two pictures of one size, not {}x{} and {}x{}",
                            earlier.width_px, earlier.height_px, later.width_px, later.height_px));
  }
  to_grey(earlier, impl_->earlier);
  to_grey(later, impl_->later);
  impl_->dis->calc(impl_->earlier, impl_->later, impl_->there);
  impl_->dis->calc(impl_->later, impl_->earlier, impl_->back);
  const int width = earlier.width_px;
  const int height = earlier.height_px;
  out.width_px = width;
  out.height_px = height;
  out.flow_px.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  out.confidence.resize(out.flow_px.size());
  for (int y = 0; y < height; ++y) {
    const auto* there = impl_->there.ptr<cv::Vec2f>(y);
    for (int x = 0; x < width; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
      const Eigen::Vector2f forth(there[x][0], there[x][1]);
      out.flow_px[at] = forth;
      const float to_x = static_cast<float>(x) + forth.x();
      const float to_y = static_cast<float>(y) + forth.y();
      float confidence = 0;
      if (to_x >= 0 && to_y >= 0 && to_x < static_cast<float>(width - 1) &&
          to_y < static_cast<float>(height - 1)) {
        const int left = static_cast<int>(to_x);
        const int top = static_cast<int>(to_y);
        const float u = to_x - static_cast<float>(left);
        const float v = to_y - static_cast<float>(top);
        const auto* upper = impl_->back.ptr<cv::Vec2f>(top);
        const auto* lower = impl_->back.ptr<cv::Vec2f>(top + 1);
        const cv::Vec2f again = (upper[left] * (1 - u) + upper[left + 1] * u) * (1 - v) +
                                (lower[left] * (1 - u) + lower[left + 1] * u) * v;
        const float trip = (forth + Eigen::Vector2f(again[0], again[1])).norm();
        confidence = std::max(0.0F, 1 - trip / kTripLimitPx);
      }
      out.confidence[at] = confidence;
    }
  }
}

}  // namespace facet::fit
