#include "camera/turned_camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <utility>

#include "camera/pixel_buffers.hpp"
#include "facet/error.hpp"

namespace facet::camera {
namespace {

/// Pixels of a tile's side: rows of both pictures stay in the cache while a tile is copied.
constexpr int kTile_px = 16;

/// Where the pixel of the turned picture's place (0, 0) is in the given one, and the steps in the given one
/// that go with a step to the right and one down.
struct Walk {
  int x = 0, y = 0;
  int right_x = 0, right_y = 0;
  int down_x = 0, down_y = 0;
};

/// width_px, height_px: of the given picture.
Walk walk_of(const PictureTurn& turn, int width_px, int height_px) {
  Walk walk;
  switch (turn.clockwise_deg) {
    case 90:
      walk = {0, height_px - 1, 0, -1, 1, 0};
      break;
    case 180:
      walk = {width_px - 1, height_px - 1, -1, 0, 0, -1};
      break;
    case 270:
      walk = {width_px - 1, 0, 0, 1, -1, 0};
      break;
    default:
      walk = {0, 0, 1, 0, 0, 1};
  }
  if (turn.mirror) {
    const int last = (turn.clockwise_deg % 180 == 0 ? width_px : height_px) - 1;
    walk.x += last * walk.right_x;
    walk.y += last * walk.right_y;
    walk.right_x = -walk.right_x;
    walk.right_y = -walk.right_y;
  }
  return walk;
}

class TurnedCamera final : public Camera {
 public:
  TurnedCamera(std::unique_ptr<Camera> camera, const PictureTurn& turn)
      : camera_(std::move(camera)), turn_(turn) {}

  CameraInfo info() const override {
    CameraInfo info = camera_->info();
    if (swaps()) {
      std::swap(info.width_px, info.height_px);
    }
    if (info.intrinsics) {
      info.intrinsics = turned(*info.intrinsics, turn_);
    }
    return info;
  }
  CameraStatus status() const override { return camera_->status(); }
  void start() override { camera_->start(); }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    if (outcome != CaptureOutcome::Delivered || out.empty()) {
      return outcome;
    }
    try {
      turn(out);
      return outcome;
    } catch (const std::bad_alloc&) {
      out = {};
      return CaptureOutcome::Timeout;  // the next picture finds memory, or not
    }
  }
  void restart(const std::string& why) override { camera_->restart(why); }
  void expect_frames(bool due) override { camera_->expect_frames(due); }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return camera_->last_error(); }

 private:
  bool swaps() const { return turn_.clockwise_deg % 180 != 0; }

  void turn(Frame& frame) {
    const int width_px = swaps() ? frame.height_px : frame.width_px;
    const int height_px = swaps() ? frame.width_px : frame.height_px;
    const auto stride_bytes = static_cast<std::size_t>(rgba_stride_bytes(width_px));
    const std::size_t size_bytes = stride_bytes * static_cast<std::size_t>(height_px);
    if (size_bytes != size_bytes_) {
      size_bytes_ = size_bytes;
      buffers_ = std::make_shared<PixelBuffers>();  // which are of one size
    }
    const std::shared_ptr<std::uint8_t[]> pixels = buffers_->take(size_bytes);
    const Walk walk = walk_of(turn_, frame.width_px, frame.height_px);
    const std::ptrdiff_t right_bytes =
        4 * walk.right_x + walk.right_y * static_cast<std::ptrdiff_t>(frame.stride_bytes);
    for (int top = 0; top < height_px; top += kTile_px) {
      for (int left = 0; left < width_px; left += kTile_px) {
        const int right = std::min(left + kTile_px, width_px);
        for (int y = top; y < std::min(top + kTile_px, height_px); ++y) {
          const std::uint8_t* from = frame.row(walk.y + left * walk.right_y + y * walk.down_y) +
                                     std::ptrdiff_t{4} * (walk.x + left * walk.right_x + y * walk.down_x);
          std::uint8_t* to = pixels.get() + static_cast<std::size_t>(y) * stride_bytes +
                             std::size_t{4} * static_cast<std::size_t>(left);
          for (int x = left; x < right; ++x, to += 4, from += right_bytes) {
            std::memcpy(to, from, 4);
          }
        }
      }
    }
    frame.width_px = width_px;
    frame.height_px = height_px;
    frame.stride_bytes = stride_bytes;
    frame.pixels = pixels;
  }

  std::unique_ptr<Camera> camera_;
  PictureTurn turn_;
  std::shared_ptr<PixelBuffers> buffers_;
  std::size_t size_bytes_ = 0;
};

}  // namespace

CameraIntrinsics turned(const CameraIntrinsics& given, const PictureTurn& turn) {
  const auto last_x = static_cast<float>(given.width_px - 1);
  const auto last_y = static_cast<float>(given.height_px - 1);
  CameraIntrinsics out = given;
  if (turn.clockwise_deg % 180 != 0) {
    std::swap(out.fx, out.fy);
    std::swap(out.width_px, out.height_px);
  }
  switch (turn.clockwise_deg) {
    case 90:
      out.cx = last_y - given.cy;
      out.cy = given.cx;
      break;
    case 180:
      out.cx = last_x - given.cx;
      out.cy = last_y - given.cy;
      break;
    case 270:
      out.cx = given.cy;
      out.cy = last_x - given.cx;
      break;
    default:
      break;
  }
  if (turn.mirror) {
    out.cx = static_cast<float>(out.width_px - 1) - out.cx;
  }
  return out;
}

std::unique_ptr<Camera> turn_pictures(std::unique_ptr<Camera> camera, const PictureTurn& turn) {
  if (turn.clockwise_deg % 90 != 0 || turn.clockwise_deg < 0 || turn.clockwise_deg > 270) {
    throw Error(ErrorKind::Usage, fmt::format("turn = {}: pictures are turned by 0, 90, 180 or 270 degrees",
                                              turn.clockwise_deg));
  }
  return turn.plain() ? std::move(camera) : std::make_unique<TurnedCamera>(std::move(camera), turn);
}

}  // namespace facet::camera
