#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "facet/frame_set.hpp"

/// The pictures of a frame set as bytes: one record a picture; docs/take-format.md is the page.
namespace facet::take {

/// Most bytes of a set's pixels, three a pixel, that are written or read.
inline constexpr std::size_t kMaxSetBytes = 256U << 20;

/// The fixed part of a record, little-endian as it lies in the file; `payload_bytes` of payload follow, then
/// zeros up to a multiple of 8.
struct PictureRecord {
  std::uint32_t magic = 0;
  std::uint32_t crc = 0;           ///< crc32c of what follows it here, and of the payload
  std::uint64_t frame_number = 0;  ///< in the take
  std::uint64_t slot = 0;          ///< FrameSet::slot
  std::int64_t timestamp_ns = 0;   ///< Frame::timestamp_ns
  std::uint32_t payload_bytes = 0;
  std::uint16_t width_px = 0;
  std::uint16_t height_px = 0;
  std::uint8_t camera = 0;
  std::uint8_t channels = 0;  ///< 1 or 3
  std::uint8_t codec = 0;     ///< kRowDifferences or kJpeg
  std::uint8_t unused[5] = {};
};
static_assert(sizeof(PictureRecord) == 48);

inline constexpr std::uint32_t kRecordMagic = 0x43525046;  // "FPRC" in memory
/// The payload is one zstd frame of [height_px][width_px * channels] bytes: each the difference, modulo 256,
/// to the byte above; in the first row to the same channel on the left, and the first pixel as it is.
inline constexpr std::uint8_t kRowDifferences = 1;
/// The payload is a JPEG file.
inline constexpr std::uint8_t kJpeg = 2;

enum class PictureCoding : std::uint8_t {
  Lossless,  ///< kRowDifferences: for depth and measuring
  Jpeg,      ///< kJpeg at kJpegQuality: some 0.2 bytes a pixel
};
/// Cameras' own Motion JPEG is hardly finer.
inline constexpr int kJpegQuality = 92;

/// Makes records. One thread; memory is reused.
class PictureWriter {
 public:
  explicit PictureWriter(PictureCoding coding = PictureCoding::Lossless);
  ~PictureWriter();
  PictureWriter(const PictureWriter&) = delete;
  PictureWriter& operator=(const PictureWriter&) = delete;

  /// Appends the records of all pictures of a set to `out`. Returns false, and appends nothing, where they
  /// are more than kMaxSetBytes or one is wider or higher than stream::kMaxImagePx.
  bool append(const FrameSet& set, std::uint64_t frame_number, std::vector<std::uint8_t>& out);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Gives records another frame's number: what a cut writes of another take's, picture by picture as they are.
/// records: all those of the frame `from`, and nothing else. Throws Error(UnreadableInput) where they are
/// damaged or of another frame.
void renumber(std::span<std::uint8_t> records, std::uint64_t from, std::uint64_t to);

/// Reads records, bytes from outside. One thread; memory is reused.
class PictureReader {
 public:
  PictureReader();
  ~PictureReader();
  PictureReader(const PictureReader&) = delete;
  PictureReader& operator=(const PictureReader&) = delete;

  /// Gives the pictures of `set`, whose sizes are known and whose pixels are missing, their pixels. records:
  /// all those of this frame and nothing else. Throws Error(UnreadableInput) with the camera and what is
  /// wrong: checksum, a record of another frame, an unknown codec, another size.
  void read(std::span<const std::uint8_t> records, std::uint64_t frame_number, FrameSet& set);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::take
