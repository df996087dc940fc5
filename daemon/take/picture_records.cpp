#include "take/picture_records.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <string>

#include "facet/assert.hpp"
#include "facet/error.hpp"
#include "files/image_file.hpp"
#include "stream/pixel_packing.hpp"
#include "stream/protocol.hpp"
#include "take/checksum.hpp"
#include "take/take_file.hpp"

namespace facet::take {
namespace {

static_assert(std::endian::native == std::endian::little, "records are little-endian");

constexpr std::size_t kCrcEnd = offsetof(PictureRecord, frame_number);
constexpr std::size_t kPadding = 8;
// Noise has no repetitions worth a search: what zstd gains, its entropy coder does. The smallest table of
// matches that still finds plain areas makes it faster than level 1 and no worse
// (docs/decisions/take-codec.md).
constexpr int kLevel = 1;
constexpr int kHashLog = 8;
constexpr int kShortestMatch = 7;

std::size_t pixel_count(const Frame& frame) {
  return static_cast<std::size_t>(frame.width_px) * static_cast<std::size_t>(frame.height_px);
}

std::size_t padded(std::size_t bytes) {
  return (bytes + kPadding - 1) / kPadding * kPadding;
}

/// pixels, differences [rows][row_bytes], apart from one another
void subtract_rows(const std::uint8_t* pixels, std::size_t rows, std::size_t row_bytes, std::size_t channels,
                   std::uint8_t* differences) {
  std::copy_n(pixels, channels, differences);
  for (std::size_t x = channels; x < row_bytes; ++x) {
    differences[x] = static_cast<std::uint8_t>(pixels[x] - pixels[x - channels]);
  }
  for (std::size_t i = row_bytes; i < rows * row_bytes; ++i) {
    differences[i] = static_cast<std::uint8_t>(pixels[i] - pixels[i - row_bytes]);
  }
}

void add_rows(std::uint8_t* pixels, std::size_t rows, std::size_t row_bytes, std::size_t channels) {
  for (std::size_t x = channels; x < row_bytes; ++x) {
    pixels[x] = static_cast<std::uint8_t>(pixels[x] + pixels[x - channels]);
  }
  for (std::size_t y = 1; y < rows; ++y) {
    const std::uint8_t* above = pixels + (y - 1) * row_bytes;
    std::uint8_t* row = pixels + y * row_bytes;
    for (std::size_t x = 0; x < row_bytes; ++x) {
      row[x] = static_cast<std::uint8_t>(row[x] + above[x]);
    }
  }
}

[[noreturn]] void reject(const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, what);
}

std::string name_of(const FrameSet& set, std::size_t camera) {
  return set.camera_names != nullptr && camera < set.camera_names->size()
             ? fmt::format("camera {}", (*set.camera_names)[camera])
             : fmt::format("camera {}", camera);
}

/// The fixed part of a record that is whole. records: from its first byte on. set: names the camera of one
/// that is damaged; may be null.
PictureRecord first_record(std::span<const std::uint8_t> records, const FrameSet* set) {
  PictureRecord record;
  if (records.size() < sizeof(record)) {
    reject("a picture's record is cut off");
  }
  std::memcpy(&record, records.data(), sizeof(record));
  if (record.magic != kRecordMagic) {
    reject("there is no picture's record");
  }
  if (sizeof(record) + padded(record.payload_bytes) > records.size()) {
    reject("a picture's record is cut off");
  }
  if (crc32c(records.subspan(kCrcEnd, sizeof(record) - kCrcEnd + record.payload_bytes)) != record.crc) {
    reject(fmt::format("{}: the checksum is wrong", set != nullptr
                                                        ? name_of(*set, record.camera)
                                                        : fmt::format("camera {}", record.camera)));
  }
  return record;
}

}  // namespace

struct PictureWriter::Impl {
  struct Free {
    void operator()(ZSTD_CCtx* owned) const { ZSTD_freeCCtx(owned); }
  };
  std::unique_ptr<ZSTD_CCtx, Free> context{made(ZSTD_createCCtx())};
  PictureCoding coding = PictureCoding::Lossless;
  std::vector<std::uint8_t> pixels;
  std::vector<std::uint8_t> differences;

  void append_payload(const Frame& frame, std::size_t channels, std::vector<std::uint8_t>& out);
  void append(const Frame& frame, PictureRecord record, std::vector<std::uint8_t>& out);
};

PictureWriter::PictureWriter(PictureCoding coding) : impl_(std::make_unique<Impl>()) {
  impl_->coding = coding;
  ZSTD_CCtx_setParameter(impl_->context.get(), ZSTD_c_compressionLevel, kLevel);
  ZSTD_CCtx_setParameter(impl_->context.get(), ZSTD_c_hashLog, kHashLog);
  ZSTD_CCtx_setParameter(impl_->context.get(), ZSTD_c_minMatch, kShortestMatch);
}

PictureWriter::~PictureWriter() = default;

void PictureWriter::Impl::append_payload(const Frame& frame, std::size_t channels,
                                         std::vector<std::uint8_t>& out) {
  const std::size_t bytes = pixel_count(frame) * channels;
  pixels.resize(std::max(pixels.size(), bytes));
  stream::pack_pixels(frame, channels, pixels.data());
  if (coding == PictureCoding::Jpeg) {
    const std::vector<std::uint8_t> file =
        files::encode_jpeg(frame.width_px, frame.height_px, {pixels.data(), bytes}, kJpegQuality);
    out.insert(out.end(), file.begin(), file.end());
    return;
  }
  differences.resize(std::max(differences.size(), bytes));
  subtract_rows(pixels.data(), static_cast<std::size_t>(frame.height_px),
                static_cast<std::size_t>(frame.width_px) * channels, channels, differences.data());
  const std::size_t payload = out.size();
  out.resize(payload + ZSTD_compressBound(bytes));
  const std::size_t size =
      ZSTD_compress2(context.get(), out.data() + payload, out.size() - payload, differences.data(), bytes);
  if (ZSTD_isError(size) != 0U) {
    throw Error(ErrorKind::Internal, fmt::format("take: cannot compress: {}", ZSTD_getErrorName(size)));
  }
  out.resize(payload + size);
}

void PictureWriter::Impl::append(const Frame& frame, PictureRecord record, std::vector<std::uint8_t>& out) {
  const std::size_t channels = stream::channel_count(frame);
  // What a reader demands of a record.
  FACET_ASSERT((channels == 1 || channels == 3) && pixel_count(frame) * channels <= kMaxSetBytes, channels,
               record.camera);
  const std::size_t begin = out.size();
  out.resize(begin + sizeof(PictureRecord));
  append_payload(frame, channels, out);
  const std::size_t size = out.size() - begin - sizeof(PictureRecord);
  record.timestamp_ns = frame.timestamp_ns;
  record.payload_bytes = static_cast<std::uint32_t>(size);
  record.width_px = static_cast<std::uint16_t>(frame.width_px);
  record.height_px = static_cast<std::uint16_t>(frame.height_px);
  record.channels = static_cast<std::uint8_t>(channels);
  record.codec = coding == PictureCoding::Jpeg ? kJpeg : kRowDifferences;
  std::memcpy(out.data() + begin, &record, sizeof(record));
  record.crc = crc32c(std::span(out).subspan(begin + kCrcEnd));
  std::memcpy(out.data() + begin, &record, kCrcEnd);
  out.resize(begin + sizeof(record) + padded(size));
}

bool PictureWriter::append(const FrameSet& set, std::uint64_t frame_number, std::vector<std::uint8_t>& out) {
  std::size_t bytes = 0;
  for (const Frame& frame : set.frames) {
    if (frame.empty()) {
      continue;
    }
    bytes += pixel_count(frame) * 3;
    if (bytes > kMaxSetBytes || frame.width_px > static_cast<int>(stream::kMaxImagePx) ||
        frame.height_px > static_cast<int>(stream::kMaxImagePx)) {
      return false;
    }
  }
  for (std::size_t camera = 0; camera < std::min(set.frames.size(), kMaxCameras); ++camera) {
    if (!set.frames[camera].empty()) {
      PictureRecord record;
      record.magic = kRecordMagic;
      record.frame_number = frame_number;
      record.slot = set.slot;
      record.camera = static_cast<std::uint8_t>(camera);
      impl_->append(set.frames[camera], record, out);
    }
  }
  return true;
}

void renumber(std::span<std::uint8_t> records, std::uint64_t from, std::uint64_t to) {
  while (!records.empty()) {
    PictureRecord record = first_record(records, nullptr);
    if (record.frame_number != from) {
      reject(
          fmt::format("a picture of camera {} of frame {} stands here", record.camera, record.frame_number));
    }
    record.frame_number = to;
    std::memcpy(records.data(), &record, sizeof(record));
    record.crc = crc32c(records.subspan(kCrcEnd, sizeof(record) - kCrcEnd + record.payload_bytes));
    std::memcpy(records.data(), &record, kCrcEnd);
    records = records.subspan(sizeof(record) + padded(record.payload_bytes));
  }
}

struct PictureReader::Impl {
  struct Free {
    void operator()(ZSTD_DCtx* owned) const { ZSTD_freeDCtx(owned); }
  };
  std::unique_ptr<ZSTD_DCtx, Free> context{made(ZSTD_createDCtx())};
  std::vector<std::uint8_t> pixels;

  void read(const PictureRecord& record, std::span<const std::uint8_t> payload, const std::string& camera,
            Frame& frame);
};

PictureReader::PictureReader() : impl_(std::make_unique<Impl>()) {}
PictureReader::~PictureReader() = default;

void PictureReader::Impl::read(const PictureRecord& record, std::span<const std::uint8_t> payload,
                               const std::string& camera, Frame& frame) {
  if (record.codec != kRowDifferences && record.codec != kJpeg) {
    reject(fmt::format("{}: its codec {} is unknown: use a newer Facet", camera, record.codec));
  }
  if (record.width_px != frame.width_px || record.height_px != frame.height_px ||
      (record.channels != 1 && record.channels != 3)) {
    reject(fmt::format("{}: a picture of another size", camera));
  }
  if (record.codec == kJpeg) {
    const auto image = files::parse_image<std::uint8_t>(std::as_bytes(payload), camera, pixel_count(frame));
    if (image.width_px != frame.width_px || image.height_px != frame.height_px) {
      reject(fmt::format("{}: a picture of another size", camera));
    }
    frame.pixels = stream::unpack_pixels(image.values.data(), 3, pixel_count(frame));
    return;
  }
  const std::size_t channels = record.channels;
  const std::size_t bytes = pixel_count(frame) * channels;
  if (ZSTD_getFrameContentSize(payload.data(), payload.size()) != bytes) {
    reject(fmt::format("{}: not a picture of its size", camera));
  }
  pixels.resize(std::max(pixels.size(), bytes));
  const std::size_t written =
      ZSTD_decompressDCtx(context.get(), pixels.data(), bytes, payload.data(), payload.size());
  if (ZSTD_isError(written) != 0U || written != bytes) {
    reject(fmt::format("{}: damaged picture ({})", camera,
                       ZSTD_isError(written) != 0U ? ZSTD_getErrorName(written) : "too short"));
  }
  add_rows(pixels.data(), record.height_px, static_cast<std::size_t>(record.width_px) * channels, channels);
  frame.pixels = stream::unpack_pixels(pixels.data(), channels, pixel_count(frame));
}

void PictureReader::read(std::span<const std::uint8_t> records, std::uint64_t frame_number, FrameSet& set) {
  std::size_t total = 0;
  while (!records.empty()) {
    const PictureRecord record = first_record(records, &set);
    const std::size_t size = sizeof(record) + padded(record.payload_bytes);
    if (record.frame_number != frame_number || record.slot != set.slot ||
        record.camera >= set.frames.size() || (set.missing >> record.camera & 1U) != 0 ||
        !set.frames[record.camera].empty()) {
      reject(
          fmt::format("a picture of camera {} of frame {} stands here", record.camera, record.frame_number));
    }
    Frame& frame = set.frames[record.camera];
    total += pixel_count(frame) * 3;
    if (total > kMaxSetBytes) {
      reject("more pixels than a set may have");
    }
    impl_->read(record, records.subspan(sizeof(record), record.payload_bytes), name_of(set, record.camera),
                frame);
    records = records.subspan(size);
  }
}

}  // namespace facet::take
