#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "render/renderer.hpp"

namespace facet::simulation {

enum class VideoCodec {
  Lossless,  ///< FFV1 with 8-bit RGB planes: decodes to exactly the pictures put in
  /// H.264 (main profile, no B-frames, a key frame every 2 s) as webcams and calls send it: BT.709, 4:2:0.
  H264,
  MotionJpeg,  ///< as USB cameras send it: BT.601 full range, 4:2:0, the quantisers of JPEG quality 80 to 85
};

/// What H.264 of this size and rate gets: 3 Mbit/s for 1280x720 px at 30 Hz, by the 0.75th power of the
/// number of pixels and by the rate.
std::int64_t webcam_bits_per_second(int width_px, int height_px, int rate_hz);

/// Writes a Matroska file. The same pictures give the same bytes. One thread.
class VideoWriter {
 public:
  /// Throws Error(Storage) where the file can't be made, Error(Usage) for a size below 1, a rate of 0, an
  /// odd size where chroma is halved, Error(Unavailable) where FFmpeg's libraries are not installed, naming
  /// them, or have no encoder of H.264.
  VideoWriter(const std::filesystem::path& file, int width_px, int height_px, int rate_hz,
              VideoCodec codec = VideoCodec::Lossless);
  /// Closes the file if finish() was not called; a failure then goes unreported.
  ~VideoWriter();
  VideoWriter(const VideoWriter&) = delete;
  VideoWriter& operator=(const VideoWriter&) = delete;

  /// Appends a frame. Throws Error(Storage) where it can't be written, Error(Internal) for another size.
  void append(const render::Picture& picture);
  /// Writes what is left and closes the file. Throws Error(Storage).
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::simulation
