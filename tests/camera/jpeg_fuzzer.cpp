#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>

#include "camera/jpeg_decoder.hpp"

namespace {

constexpr int kWidth_px = 36;
constexpr int kHeight_px = 20;
constexpr std::size_t kStride_bytes = 4 * kWidth_px;

}  // namespace

/// Any bytes as a camera's JPEG picture: an outcome, nothing written behind the pixels, and all of them
/// opaque where there is a picture.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static facet::camera::JpegDecoder decoder;
  std::array<std::uint8_t, kStride_bytes * kHeight_px + 1> rgba{};
  const auto outcome = decoder.decode({data, size}, kWidth_px, kHeight_px, rgba.data(), kStride_bytes);
  bool sound = rgba.back() == 0;
  if (outcome != facet::camera::JpegOutcome::Unreadable) {
    for (std::size_t i = 3; i < kStride_bytes * kHeight_px; i += 4) {
      sound = sound && rgba[i] == 255;
    }
  }
  if (!sound) {
    std::abort();
  }
  return 0;
}
