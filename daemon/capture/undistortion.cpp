#include "capture/undistortion.hpp"

#include <opencv2/imgproc.hpp>

namespace facet::capture {

struct Undistortion::Impl {
  Lens lens;          ///< without distortion
  cv::Mat source_px;  ///< where each pixel is taken from, in remap's whole numbers ...
  cv::Mat fractions;  ///< ... and the rest
};

Undistortion::Undistortion(const Lens& lens) : impl_(std::make_unique<Impl>()) {
  impl_->lens = lens;
  impl_->lens.distortion = {};
  const Eigen::Isometry3d rig_from_camera = lens.camera_from_rig.inverse();
  cv::Mat wanted_px(lens.height_px, lens.width_px, CV_32FC2);
  for (int y = 0; y < lens.height_px; ++y) {
    for (int x = 0; x < lens.width_px; ++x) {
      const Eigen::Vector3d direction((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1);
      const auto at = lens.project(rig_from_camera * direction);
      wanted_px.at<cv::Vec2f>(y, x) =
          at ? cv::Vec2f(static_cast<float>(at->x()), static_cast<float>(at->y())) : cv::Vec2f(-1, -1);
    }
  }
  cv::convertMaps(wanted_px, cv::noArray(), impl_->source_px, impl_->fractions, CV_16SC2);
}

Undistortion::~Undistortion() = default;
Undistortion::Undistortion(Undistortion&&) noexcept = default;

const Lens& Undistortion::lens() const {
  return impl_->lens;
}

Frame Undistortion::apply(const Frame& frame) const {
  const Lens& lens = impl_->lens;
  if (frame.empty() || frame.width_px != lens.width_px || frame.height_px != lens.height_px) {
    return {};
  }
  Frame out = frame;
  out.stride_bytes = 4 * static_cast<std::size_t>(frame.width_px);
  const auto pixels =
      std::make_shared<std::uint8_t[]>(out.stride_bytes * static_cast<std::size_t>(frame.height_px));
  // remap takes a writable Mat; it does not write to its source.
  const cv::Mat source(frame.height_px, frame.width_px, CV_8UC4,
                       const_cast<std::uint8_t*>(frame.pixels.get()), frame.stride_bytes);
  cv::Mat target(frame.height_px, frame.width_px, CV_8UC4, pixels.get(), out.stride_bytes);
  cv::remap(source, target, impl_->source_px, impl_->fractions, cv::INTER_LINEAR, cv::BORDER_CONSTANT,
            cv::Scalar(0, 0, 0, 255));
  out.pixels = pixels;
  return out;
}

}  // namespace facet::capture
