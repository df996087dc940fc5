#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace facet {

/// One image of one camera, as every driver hands it out: 8-bit sRGB, R G B A in memory order (A = 255), top
/// row first. A driver with another pixel format converts at its door. The pixels are shared and never change
/// after delivery, so a Frame may be copied cheaply and read on any thread.
struct Frame {
  /// Counts the frames that the source produced, dropped ones included; starts at 0.
  std::uint64_t sequence = 0;
  /// CLOCK_MONOTONIC at the start of exposure (paced file: when the frame was due).
  std::int64_t timestamp_ns = 0;
  /// Position in a recorded source, 0 at its first frame; live: since the first frame.
  std::int64_t media_time_ns = 0;
  int width_px = 0;
  int height_px = 0;
  std::size_t stride_bytes = 0;                  ///< from one row to the next, >= 4 * width_px
  bool corrupt = false;                          ///< the driver says that the pixels are damaged
  std::shared_ptr<const std::uint8_t[]> pixels;  ///< [height_px][stride_bytes], null in an empty frame

  bool empty() const { return pixels == nullptr; }
  const std::uint8_t* row(int y) const { return pixels.get() + static_cast<std::size_t>(y) * stride_bytes; }
};

/// Pinhole intrinsics of an undistorted image, OpenCV convention: u = fx x/z + cx, pixel centres at integers.
struct CameraIntrinsics {
  float fx = 0;
  float fy = 0;
  float cx = 0;
  float cy = 0;
  int width_px = 0;
  int height_px = 0;
};

}  // namespace facet
