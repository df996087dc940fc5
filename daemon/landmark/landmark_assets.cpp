#include "landmark/landmark_assets.hpp"

#include <fmt/format.h>

#include <array>
#include <cerrno>
#include <fstream>

#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::landmark {
namespace {

/// Where the parts lie, as the package's loader script lists them.
constexpr std::size_t landmarks_begin = 2'495'952;
constexpr std::size_t geometry_begin = 3'737'848;
constexpr std::size_t detector_begin = 3'757'224;
constexpr std::size_t file_size = 3'986'256;
constexpr std::uint32_t file_crc = 0x19fd0f52U;

constexpr std::array<std::uint32_t, 256> crc_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t rest = byte;
    for (int bit = 0; bit < 8; ++bit) {
      rest = (rest >> 1U) ^ ((rest & 1U) != 0 ? 0xEDB88320U : 0U);
    }
    table[byte] = rest;
  }
  return table;
}

}  // namespace

std::uint32_t crc32(std::span<const std::uint8_t> bytes) {
  static constexpr auto table = crc_table();
  std::uint32_t crc = ~0U;
  for (const std::uint8_t byte : bytes) {
    crc = (crc >> 8U) ^ table[(crc ^ byte) & 0xFFU];
  }
  return ~crc;
}

LandmarkAssets LandmarkAssets::load(const std::filesystem::path& file) {
  constexpr const char* remedy = "run packaging/fetch-assets to download it";
  // The streams of the library say that something failed, and leave in errno what.
  errno = 0;
  std::ifstream stream(file, std::ios::binary);
  if (!stream) {
    const int error = errno;
    throw Error(kind_of_errno(error),
                fmt::format("{}: cannot open the landmark nets: {}{}", file.string(), describe_errno(error),
                            may_pass(error) ? "" : fmt::format("; {}", remedy)));
  }
  LandmarkAssets assets;
  // One byte more than it should hold, so that a longer file shows without being read whole.
  assets.bytes_.resize(file_size + 1);
  stream.read(reinterpret_cast<char*>(assets.bytes_.data()),
              static_cast<std::streamsize>(assets.bytes_.size()));
  if (const int error = errno; stream.bad()) {
    throw Error(kind_of_errno(error),
                fmt::format("{}: cannot read the landmark nets: {}", file.string(), describe_errno(error)));
  }
  assets.bytes_.resize(static_cast<std::size_t>(stream.gcount()));
  if (assets.bytes_.size() != file_size) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("{}: has {} {} bytes, @mediapipe/face_mesh 0.4.1657299874 has {}; {}", file.string(),
                    assets.bytes_.size() > file_size ? "more than" : "only",
                    assets.bytes_.size() > file_size ? file_size : assets.bytes_.size(), file_size, remedy));
  }
  if (const std::uint32_t crc = crc32(assets.bytes_); crc != file_crc) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: damaged (CRC-32 {:08x}, expected {:08x}); remove it and {}", file.string(),
                            crc, file_crc, remedy));
  }
  return assets;
}

std::span<const std::uint8_t> LandmarkAssets::attention_landmarks() const {
  return std::span(bytes_).first(landmarks_begin);
}
std::span<const std::uint8_t> LandmarkAssets::landmarks() const {
  return std::span(bytes_).subspan(landmarks_begin, geometry_begin - landmarks_begin);
}
std::span<const std::uint8_t> LandmarkAssets::geometry() const {
  return std::span(bytes_).subspan(geometry_begin, detector_begin - geometry_begin);
}
std::span<const std::uint8_t> LandmarkAssets::detector() const {
  return std::span(bytes_).subspan(detector_begin, file_size - detector_begin);
}

}  // namespace facet::landmark
