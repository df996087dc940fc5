#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "render/renderer.hpp"

namespace facet::render {

enum class VideoCodec {
  Lossless,  ///< FFV1 with 8-bit RGB planes: decodes to exactly the pictures put in
  /// H.264 (main profile, no B-frames, a key frame every 2 s) as webcams and calls send it: BT.709, 4:2:0.
  H264,
  MotionJpeg,  ///< as USB cameras send it: BT.601 full range, 4:2:0, the quantisers of JPEG quality 80 to 85
  /// H.264 at a constant quality, a key frame every half second, for people to look at and scrub through, in
  /// MP4, which alone has sound and timecode; BT.709, 4:2:0.
  Film,
};

/// What H.264 of this size and rate gets: 3 Mbit/s for 1280x720 px at 30 Hz, by the 0.75th power of the
/// number of pixels and by the rate.
std::int64_t webcam_bits_per_second(int width_px, int height_px, int rate_hz);

/// Sound in a film, AAC.
struct FilmSound {
  int rate_hz = 48000;
  int channels = 1;
};

struct VideoFormat {
  int width_px = 0;
  int height_px = 0;
  double rate_hz = 30;  ///< a whole number but for Film
  VideoCodec codec = VideoCodec::Lossless;
  std::optional<FilmSound> sound{};  ///< of Film
  std::string timecode{};            ///< of the first picture, "HH:MM:SS:FF" at rate_hz, of Film; empty: none
};
/// Why a film can't have such sound; empty: it can. Throws Error(Unavailable) where FFmpeg is not installed.
std::string fault_of(const FilmSound& sound);
/// Whether a film of this rate can have timecode: those that editors know, 24 to 60 and their multiples.
bool takes_timecode(double rate_hz);

/// Writes a Matroska file, or MP4 (Film). The same pictures give the same bytes. One thread.
class VideoWriter {
 public:
  /// Throws Error(Storage) where the file can't be made, Error(Usage) for a size below 1, a rate of 0, an
  /// odd size where chroma is halved, a rate or number of channels that AAC has not, Error(Unavailable) where
  /// FFmpeg's libraries are not installed, naming them, or have no encoder of H.264 or AAC.
  VideoWriter(const std::filesystem::path& file, const VideoFormat& format);
  VideoWriter(const std::filesystem::path& file, int width_px, int height_px, int rate_hz,
              VideoCodec codec = VideoCodec::Lossless)
      : VideoWriter(file, VideoFormat{width_px, height_px, static_cast<double>(rate_hz), codec, {}, {}}) {}
  /// Leaves no file where finish() was not called.
  ~VideoWriter();
  VideoWriter(const VideoWriter&) = delete;
  VideoWriter& operator=(const VideoWriter&) = delete;

  /// Appends a frame. Throws Error(Storage) where it can't be written, Error(Internal) for another size or a
  /// time that does not rise.
  ///
  /// time_s  of Film: when it is shown, 1/90000 s and more after the one before; none: its number over the
  ///         rate
  void append(const Picture& picture, std::optional<double> time_s = std::nullopt);
  /// Appends sound behind what was appended before, the first sample at time 0. Pictures and sound are best
  /// appended in turn: what one is ahead of the other is held in memory. samples: [any][channels], 24 bits.
  /// Throws as append does.
  void append_sound(std::span<const std::int32_t> samples);
  /// Writes what is left and closes the file. Throws Error(Storage).
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::render
