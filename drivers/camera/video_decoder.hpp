#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "camera/pixel_buffers.hpp"

namespace facet::camera {

/// The sides of a picture that a video may have.
inline constexpr int kMostVideoSide_px = 16384;
/// Pictures in a row that can't be decoded, with none between; then the rest of a file is given up.
inline constexpr int kMostVideoErrors = 100;

/// What a video file says of itself.
struct VideoFacts {
  int width_px = 0;  ///< as pictures come out: upright, of square pixels
  int height_px = 0;
  double rate_hz = 0;                          ///< 0 where it does not say
  std::optional<std::uint64_t> frame_count{};  ///< none where it does not say
  std::int64_t duration_ns = 0;                ///< 0 where it does not say
};

/// The pictures of one video file, in their order. One thread.
class VideoDecoder {
 public:
  virtual ~VideoDecoder() = default;
  VideoDecoder() = default;
  VideoDecoder(const VideoDecoder&) = delete;
  VideoDecoder& operator=(const VideoDecoder&) = delete;

  const VideoFacts& facts() const { return facts_; }

  /// Decodes the next picture; what can't be decoded is skipped, with the reason in trouble(). False: there
  /// is none left. Never throws.
  virtual bool advance() = 0;
  /// The picture's time from the first one on; none where the file does not say.
  virtual std::optional<std::int64_t> time_ns() const = 0;
  /// Whether some of the picture is wrong.
  virtual bool damaged() const = 0;
  /// The picture, R G B A with A = 255, in rows of rgba_stride_bytes(width_px). Null where its pixels can't
  /// be converted, with the reason in trouble(). Once a picture.
  virtual std::shared_ptr<std::uint8_t[]> take_picture() = 0;
  /// Back to the first picture. False, with the reason in trouble(), where that can't be.
  virtual bool rewind() = 0;

  /// What went wrong last, without the file's name; empty: nothing yet.
  const std::string& trouble() const { return trouble_; }
  /// How often something went wrong.
  std::uint64_t trouble_count() const { return trouble_count_; }
  /// The errno of it; 0 where it has none.
  int trouble_errno() const { return trouble_errno_; }

 protected:
  void set_trouble(std::string text, int error = 0) {
    trouble_ = std::move(text);
    trouble_errno_ = error;
    ++trouble_count_;
  }

  VideoFacts facts_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();

 private:
  std::string trouble_;
  int trouble_errno_ = 0;
  std::uint64_t trouble_count_ = 0;
};

/// Motion JPEG in AVI, read by ourselves. Null where the file is something else, or has what only FFmpeg
/// knows (fields, pixels that are not square). Throws Error where the file can't be read.
std::unique_ptr<VideoDecoder> open_avi_decoder(const std::filesystem::path& file);

/// Everything that FFmpeg reads. Throws Error(UnreadableInput) naming the file, or the library that is
/// missing.
std::unique_ptr<VideoDecoder> open_ffmpeg_decoder(const std::filesystem::path& file);

}  // namespace facet::camera
