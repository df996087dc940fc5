#include "camera/avi_index.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <string_view>

namespace facet::camera {
namespace {

// An AVI file is a tree of pieces: four letters, the size of what follows, that, and a byte where the size is
// odd. "RIFF" and "LIST" hold a kind and further pieces.
constexpr std::uint64_t kHeadBytes = 8;
constexpr std::uint64_t kListHeadBytes = 12;
constexpr std::uint32_t kMostPictureBytes = 64U << 20U;
/// More than a day of pictures with sound; what comes after is left alone.
constexpr int kMostPieces = 6'000'000;

using Letters = std::array<char, 4>;

std::string_view text(const Letters& letters) {
  return {letters.data(), letters.size()};
}

/// Little-endian numbers and letters in a piece's bytes.
class Fields {
 public:
  explicit Fields(std::span<const std::byte> bytes) : bytes_(bytes) {}
  std::uint32_t number(std::size_t at, std::size_t size = 4) const {
    std::uint32_t value = 0;
    for (std::size_t i = size; i-- > 0;) {
      value = value << 8U | std::to_integer<std::uint32_t>(bytes_[at + i]);
    }
    return value;
  }
  Letters letters(std::size_t at) const {
    Letters out{};
    for (std::size_t i = 0; i < out.size(); ++i) {
      out[i] = std::to_integer<char>(bytes_[at + i]);
    }
    return out;
  }

 private:
  std::span<const std::byte> bytes_;
};

class Walk {
 public:
  Walk(const ReadAt& read, std::uint64_t size_bytes) : read_(read), size_bytes_(size_bytes) {}

  std::optional<AviIndex> run() {
    std::array<std::byte, kListHeadBytes> head{};
    if (size_bytes_ < head.size() || !read_(0, head) || text(Fields(head).letters(0)) != "RIFF" ||
        text(Fields(head).letters(8)) != "AVI ") {
      return std::nullopt;
    }
    std::uint64_t at = 0;
    for (int pieces = 0; pieces < kMostPieces && at + kHeadBytes <= size_bytes_ && ours_; ++pieces) {
      if (!read_(at, std::span(head).first(kHeadBytes))) {
        break;
      }
      const Letters name = Fields(head).letters(0);
      const std::uint32_t size = Fields(head).number(4);
      if (text(name) == "RIFF" || text(name) == "LIST") {
        if (at + kListHeadBytes > size_bytes_ || !read_(at, head)) {
          break;
        }
        at += enter(Fields(head).letters(8)) ? kListHeadBytes : kHeadBytes + size + size % 2;
        continue;
      }
      take(name, at + kHeadBytes, size);
      at += kHeadBytes + size + size % 2;
    }
    if (!ours_ || video_stream_ < 0) {
      return std::nullopt;
    }
    index_.frame_count = std::max<std::uint64_t>(index_.frame_count, next_number_);
    if (index_.rate_hz == 0 && period_us_ > 0) {
      index_.rate_hz = 1e6 / period_us_;
    }
    return std::move(index_);
  }

 private:
  /// Whether a list is gone into. Its end needs no note: the pieces behind it follow those in it.
  bool enter(const Letters& kind) {
    if (text(kind) == "strl") {
      ++stream_;
      stream_is_video_ = false;
    }
    constexpr std::array<std::string_view, 6> kEntered = {"AVI ", "AVIX", "hdrl", "strl", "movi", "rec "};
    return std::find(kEntered.begin(), kEntered.end(), text(kind)) != kEntered.end();
  }

  void take(const Letters& name, std::uint64_t from, std::uint32_t size) {
    std::array<std::byte, 56> bytes{};
    const auto read = [&](std::size_t least) {
      const std::size_t count = std::min<std::size_t>(bytes.size(), size);
      return size >= least && from + count <= size_bytes_ && read_(from, std::span(bytes).first(count));
    };
    const Fields fields(bytes);
    if (text(name) == "avih" && read(4)) {
      period_us_ = fields.number(0);
    } else if (text(name) == "strh" && read(36)) {
      take_stream_head(fields);
    } else if (text(name) == "strf" && stream_is_video_ && read(20)) {
      take_format(fields);
    } else if (text(name) == "vprp" && stream_is_video_ && read(32)) {
      take_aspect(fields);
    } else if (video_stream_ >= 0 && name[0] == '0' + video_stream_ / 10 &&
               name[1] == '0' + video_stream_ % 10 && name[2] == 'd' && (name[3] == 'c' || name[3] == 'b')) {
      if (size > 0 && size <= kMostPictureBytes && from < size_bytes_) {
        // What is cut short is decoded as far as it goes.
        const auto there = static_cast<std::uint32_t>(std::min<std::uint64_t>(size, size_bytes_ - from));
        index_.pictures.push_back({from, there, next_number_});
      }
      ++next_number_;
    }
  }

  void take_stream_head(const Fields& fields) {
    stream_is_video_ =
        video_stream_ < 0 && stream_ >= 0 && stream_ < 100 && text(fields.letters(0)) == "vids";
    if (!stream_is_video_) {
      return;
    }
    const std::uint32_t scale = fields.number(20);
    const std::uint32_t rate = fields.number(24);
    index_.rate_hz = scale > 0 && rate > 0 ? static_cast<double>(rate) / scale : 0;
    index_.frame_count = fields.number(32);
  }

  void take_format(const Fields& fields) {
    const Letters coding = fields.letters(16);
    if (text(coding) != "MJPG" && text(coding) != "mjpg") {
      ours_ = false;
      return;
    }
    const std::int64_t width = static_cast<std::int32_t>(fields.number(4));
    const std::int64_t height =
        std::abs(static_cast<std::int64_t>(static_cast<std::int32_t>(fields.number(8))));
    constexpr std::int64_t kMostSide = 65535;  // JPEG's
    ours_ = width >= 1 && height >= 1 && width <= kMostSide && height <= kMostSide;
    index_.width_px = static_cast<int>(width);
    index_.height_px = static_cast<int>(height);
    video_stream_ = stream_;
  }

  /// The shape of a whole picture, "4:3" as two numbers, against its pixels.
  void take_aspect(const Fields& fields) {
    const double across = fields.number(22, 2);
    const double down = fields.number(20, 2);
    if (across > 0 && down > 0 && index_.height_px > 0) {
      const double width_px = index_.height_px * across / down;
      ours_ = ours_ && std::abs(width_px - index_.width_px) < 1 + 0.005 * index_.width_px;
    }
  }

  const ReadAt& read_;
  std::uint64_t size_bytes_;
  AviIndex index_;
  bool ours_ = true;
  int stream_ = -1;
  bool stream_is_video_ = false;  // the one whose pieces come now
  int video_stream_ = -1;
  std::uint32_t period_us_ = 0;
  std::uint32_t next_number_ = 0;
};

}  // namespace

std::optional<AviIndex> read_avi_index(const ReadAt& read, std::uint64_t size_bytes) {
  return Walk(read, size_bytes).run();
}

}  // namespace facet::camera
