#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <vector>

#include "camera/avi_index.hpp"
#include "camera/jpeg_decoder.hpp"
#include "camera/video_decoder.hpp"
#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::camera {
namespace {

/// A file from outside, read in pieces: one that is mapped ends the process where somebody shortens it.
class Descriptor {
 public:
  explicit Descriptor(const std::filesystem::path& file) : fd_(::open(file.c_str(), O_RDONLY | O_CLOEXEC)) {
    if (fd_ < 0) {
      const int error = errno;
      throw Error(kind_of_errno(error),
                  fmt::format("{}: can't be read: {}", file.string(), describe_errno(error)));
    }
  }
  ~Descriptor() { ::close(fd_); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;

  std::uint64_t size() const {
    struct stat status {};
    return ::fstat(fd_, &status) == 0 && S_ISREG(status.st_mode) ? static_cast<std::uint64_t>(status.st_size)
                                                                 : 0;
  }
  /// False where the bytes are not there or can't be read; errno is 0 in the first case.
  bool read(std::uint64_t position, std::span<std::byte> out) const {
    while (!out.empty()) {
      const ssize_t count = ::pread(fd_, out.data(), out.size(), static_cast<off_t>(position));
      if (count <= 0) {
        if (count < 0 && errno == EINTR) {
          continue;
        }
        errno = count == 0 ? 0 : errno;
        return false;
      }
      out = out.subspan(static_cast<std::size_t>(count));
      position += static_cast<std::uint64_t>(count);
    }
    return true;
  }

 private:
  int fd_;
};

std::int64_t to_ns(double pictures, double rate_hz) {
  constexpr double kMost_ns = 9e18;
  return std::llround(std::min(1e9 * pictures / rate_hz, kMost_ns));
}

class AviDecoder final : public VideoDecoder {
 public:
  AviDecoder(std::unique_ptr<Descriptor> file, AviIndex index)
      : file_(std::move(file)), index_(std::move(index)) {
    facts_.width_px = index_.width_px;
    facts_.height_px = index_.height_px;
    facts_.rate_hz = index_.rate_hz;
    facts_.frame_count = index_.frame_count;
    if (index_.rate_hz > 0) {
      facts_.duration_ns = to_ns(static_cast<double>(index_.frame_count), index_.rate_hz);
    }
  }

  /// Whether the first picture is one of the size that the file names, of square pixels.
  bool is_plain() {
    if (index_.pictures.empty() || !advance()) {
      return false;
    }
    // A head of JFIF names the shape of a pixel.
    constexpr std::array kJfif = {std::byte{'J'}, std::byte{'F'}, std::byte{'I'}, std::byte{'F'}};
    bool square = true;
    if (jpeg_.size() > 18 && std::equal(kJfif.begin(), kJfif.end(), jpeg_.begin() + 6)) {
      square = jpeg_[14] == jpeg_[16] && jpeg_[15] == jpeg_[17];
    }
    return square && rewind();
  }

  bool advance() override {
    for (int errors = 0; errors < kMostVideoErrors && next_ < index_.pictures.size(); ++errors) {
      if (decode(index_.pictures[next_++])) {
        return true;
      }
    }
    return false;
  }
  std::optional<std::int64_t> time_ns() const override {
    if (index_.rate_hz <= 0) {
      return std::nullopt;
    }
    return to_ns(index_.pictures[next_ - 1].number - *first_number_, index_.rate_hz);
  }
  bool damaged() const override { return damaged_; }
  std::shared_ptr<std::uint8_t[]> take_picture() override { return std::move(picture_); }
  bool rewind() override {
    next_ = 0;
    first_number_.reset();
    return true;
  }

 private:
  bool decode(const AviPicture& from) {
    jpeg_.resize(from.size_bytes);
    if (!file_->read(from.position, jpeg_)) {
      const int error = errno;
      set_trouble(fmt::format("reading ended early at frame {} ({})", from.number,
                              error == 0 ? "the file has become shorter" : describe_errno(error)),
                  error);
      return false;
    }
    const auto stride = static_cast<std::size_t>(rgba_stride_bytes(facts_.width_px));
    if (picture_ == nullptr) {
      picture_ = pool_->take(stride * static_cast<std::size_t>(facts_.height_px));
    }
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(jpeg_.data());
    const JpegOutcome outcome =
        decoder_.decode({bytes, jpeg_.size()}, facts_.width_px, facts_.height_px, picture_.get(), stride);
    if (outcome == JpegOutcome::Unreadable) {
      set_trouble(fmt::format("a damaged part near frame {} was skipped (no JPEG picture of {}x{} px)",
                              from.number, facts_.width_px, facts_.height_px));
      return false;
    }
    damaged_ = outcome == JpegOutcome::Damaged;
    if (!first_number_) {
      first_number_ = from.number;
    }
    return true;
  }

  std::unique_ptr<Descriptor> file_;
  AviIndex index_;
  JpegDecoder decoder_;
  std::vector<std::byte> jpeg_;
  std::shared_ptr<std::uint8_t[]> picture_;
  std::size_t next_ = 0;
  std::optional<std::uint32_t> first_number_;  // of this pass over the file
  bool damaged_ = false;
};

}  // namespace

std::unique_ptr<VideoDecoder> open_avi_decoder(const std::filesystem::path& file) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(file, ignored)) {
    return nullptr;
  }
  auto opened = std::make_unique<Descriptor>(file);
  int failure = 0;
  auto index = read_avi_index(
      [&](std::uint64_t position, std::span<std::byte> out) {
        const bool read = opened->read(position, out);
        failure = !read && failure == 0 ? errno : failure;
        return read;
      },
      opened->size());
  if (failure != 0) {
    throw Error(kind_of_errno(failure),
                fmt::format("{}: can't be read: {}", file.string(), describe_errno(failure)));
  }
  if (!index || index->width_px > kMostVideoSide_px || index->height_px > kMostVideoSide_px) {
    return nullptr;
  }
  auto decoder = std::make_unique<AviDecoder>(std::move(opened), std::move(*index));
  return decoder->is_plain() ? std::move(decoder) : nullptr;
}

}  // namespace facet::camera
