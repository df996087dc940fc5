#include "animate/basis_file.hpp"

#include <fmt/format.h>
#include <sys/stat.h>

#include <cmath>
#include <cstring>

#include "facet/error.hpp"
#include "files/text_file.hpp"
#include "take/checksum.hpp"

namespace facet::animate {
namespace {

constexpr std::size_t kAlignment = 64;
constexpr std::int32_t kMostVertices = 500'000;
constexpr std::int32_t kMostFrames = 10'000'000;
constexpr std::int32_t kMostExpressions = 1024;
constexpr std::size_t kChecksummedFrom = 16;

[[noreturn]] void refuse(const std::string& what) {
  throw Error(ErrorKind::UnreadableInput, what);
}

/// Goes through the parts of a file in their order.
class Layout {
 public:
  /// Bytes may be empty: then only the sizes count.
  explicit Layout(std::span<const std::byte> bytes) : bytes_(bytes) {}

  template <typename T>
  const T* next(std::size_t count) {
    const std::size_t begin = (at_ + kAlignment - 1) / kAlignment * kAlignment;
    at_ = begin + count * sizeof(T);
    return at_ <= bytes_.size() ? reinterpret_cast<const T*>(bytes_.data() + begin) : nullptr;
  }
  std::size_t size() const { return at_; }

 private:
  std::span<const std::byte> bytes_;
  std::size_t at_ = 0;
};

BasisSections lay_out(const BasisHeader& header, std::span<const std::byte> bytes, std::size_t& size) {
  const auto as_size = [](std::int32_t count) { return static_cast<std::size_t>(count); };
  const std::size_t controls = as_size(header.control_vertex_count);
  const std::size_t finest = as_size(header.finest_vertex_count);
  const std::size_t frames = as_size(header.frame_count);
  const std::size_t coarse_rank = as_size(header.coarse_rank);
  const std::size_t detail_rank = as_size(header.detail_rank);
  const std::size_t eyes = 6 * as_size(header.eye_count);
  const std::size_t expressions = as_size(header.expression_count);
  Layout layout(bytes);
  BasisSections out;
  out.header = layout.next<BasisHeader>(1);
  out.frames = layout.next<CapturedFrame>(frames);
  out.coefficients = layout.next<float>(frames * (coarse_rank + detail_rank + eyes + expressions));
  out.coarse = layout.next<float>(coarse_rank * 3 * controls);
  out.detail = layout.next<float>(detail_rank * finest);
  out.folds = layout.next<float>(detail_rank * finest);
  out.coarse_mean = layout.next<float>(3 * controls);
  out.detail_mean = layout.next<float>(finest);
  out.eye_means = layout.next<float>(eyes);
  out.expression_means = layout.next<float>(expressions);
  out.eye_of_vertex = layout.next<std::uint8_t>(controls);
  size = layout.size();
  return out;
}

void check_header(const BasisHeader& header) {
  const auto within = [](std::int32_t value, std::int32_t least, std::int32_t most) {
    return value >= least && value <= most;
  };
  if (!within(header.control_vertex_count, 1, kMostVertices) ||
      !within(header.finest_vertex_count, 1, kMostVertices) || !within(header.coarse_rank, 0, kMaxRank) ||
      !within(header.detail_rank, 0, kMaxRank) || !within(header.eye_count, 0, kMaxEyes) ||
      !within(header.expression_count, 0, kMostExpressions) || !within(header.frame_count, 1, kMostFrames)) {
    refuse("its sizes are out of bounds");
  }
  if (!(header.frame_period_s > 0 && header.frame_period_s < 1e6)) {
    refuse(fmt::format("its frame period of {} s makes no sense", header.frame_period_s));
  }
}

/// Whether it is a basis, and as many bytes as its header says.
void check_size(const BasisHeader& header, std::size_t bytes) {
  if (header.magic != kBasisMagic) {
    refuse("it is no basis");
  }
  if (header.version != kBasisVersion) {
    refuse(fmt::format("it is of version {}, not {}", header.version, kBasisVersion));
  }
  check_header(header);
  std::size_t size = 0;
  lay_out(header, {}, size);
  if (size != bytes) {
    refuse(fmt::format("it has {} bytes instead of {}", bytes, size));
  }
}

void check_finite(const float* values, std::size_t count) {
  // A number that is not finite makes every sum with it not finite.
  float sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    sum += 0.0F * values[i];
  }
  if (!std::isfinite(sum)) {
    refuse("it holds numbers that are not finite");
  }
}

}  // namespace

FileState state_of(const std::filesystem::path& file) {
  struct stat status {};
  if (::stat(file.c_str(), &status) != 0) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("'{}': {}", file.string(), std::strerror(errno)));
  }
  return {static_cast<std::uint64_t>(status.st_size),
          std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec,
          static_cast<std::uint64_t>(status.st_ino)};
}

BasisSections basis_sections(std::span<const std::byte> bytes) {
  if (bytes.size() < sizeof(BasisHeader)) {
    refuse("it is too short");
  }
  BasisHeader header;
  std::memcpy(&header, bytes.data(), sizeof(header));
  check_size(header, bytes.size());
  std::size_t size = 0;
  const BasisSections sections = lay_out(header, bytes, size);
  const auto* start = reinterpret_cast<const std::uint8_t*>(bytes.data());
  if (take::crc32c({start + kChecksummedFrom, bytes.size() - kChecksummedFrom}) != header.crc32c) {
    refuse("its checksum is wrong");
  }
  const auto* numbers = sections.coefficients;
  check_finite(numbers,
               static_cast<std::size_t>(reinterpret_cast<const float*>(sections.eye_of_vertex) - numbers));
  for (std::int32_t f = 0; f < header.frame_count; ++f) {
    check_finite(sections.frames[f].camera_from_head.data(), 12);
    check_finite(&sections.frames[f].blink, 1);
  }
  for (std::int32_t v = 0; v < header.control_vertex_count; ++v) {
    if (sections.eye_of_vertex[v] > header.eye_count) {
      refuse("it names eyeballs that are not there");
    }
  }
  return sections;
}

BasisBytes make_basis_bytes(const BasisHeader& header) {
  check_header(header);
  std::size_t size = 0;
  lay_out(header, {}, size);
  BasisBytes bytes(size);
  std::memcpy(bytes.data(), &header, sizeof(header));
  return bytes;
}

void seal_basis(std::span<std::byte> bytes) {
  auto* header = reinterpret_cast<BasisHeader*>(bytes.data());
  const auto* start = reinterpret_cast<const std::uint8_t*>(bytes.data());
  header->crc32c = take::crc32c({start + kChecksummedFrom, bytes.size() - kChecksummedFrom});
}

BasisSections unsealed_sections(std::span<const std::byte> bytes) {
  std::size_t size = 0;
  return lay_out(*reinterpret_cast<const BasisHeader*>(bytes.data()), bytes, size);
}

std::optional<BasisBytes> read_basis(const std::filesystem::path& file) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 30;
  try {
    const files::InputFile in(file, "basis");
    BasisHeader header;
    in.read(0, std::as_writable_bytes(std::span(&header, 1)));
    check_size(header, in.size());
    if (in.size() > kMostBytes) {
      return std::nullopt;
    }
    BasisBytes bytes(in.size());
    in.read(0, bytes);
    return bytes;
  } catch (const Error&) {
    return std::nullopt;
  }
}

}  // namespace facet::animate
