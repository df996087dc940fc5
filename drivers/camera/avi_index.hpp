#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

namespace facet::camera {

/// Where one picture lies in a file.
struct AviPicture {
  std::uint64_t position = 0;
  std::uint32_t size_bytes = 0;
  std::uint32_t number = 0;  ///< from 0, those that were dropped counted
};

/// The first stream of pictures of an AVI file whose pictures are JPEG.
struct AviIndex {
  int width_px = 0;
  int height_px = 0;
  double rate_hz = 0;                  ///< 0 where the file does not say
  std::uint64_t frame_count = 0;       ///< that the file names, or has where those are more
  std::vector<AviPicture> pictures{};  ///< in their order
};

/// Fills `out` from a position on; false where the bytes are not there.
using ReadAt = std::function<bool(std::uint64_t position, std::span<std::byte> out)>;

/// Walks over a file of size_bytes, piece by piece and without trust in its own index, so that a file that
/// was cut short or never finished gives what it holds. None where it is no AVI file, its first stream of
/// pictures is not Motion JPEG, or its pixels are not square. Pictures over 64 MB count as dropped.
std::optional<AviIndex> read_avi_index(const ReadAt& read, std::uint64_t size_bytes);

}  // namespace facet::camera
