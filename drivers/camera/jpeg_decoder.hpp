#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace facet::camera {

enum class JpegOutcome {
  Whole,
  Damaged,     ///< decoded, but some of it is wrong or grey
  Unreadable,  ///< no JPEG picture of the size asked for; the pixels mean nothing
};

/// Decodes the pictures of a Motion JPEG camera, Huffman tables or not. One thread.
class JpegDecoder {
 public:
  /// Throws Error(Internal) where libjpeg-turbo does not start.
  JpegDecoder();

  /// Never throws.
  ///
  /// bytes  one picture; what follows its end is left alone
  /// rgba   [height_px][stride_bytes], R G B A with A = 255
  JpegOutcome decode(std::span<const std::uint8_t> bytes, int width_px, int height_px, std::uint8_t* rgba,
                     std::size_t stride_bytes);

 private:
  struct State;
  struct Destroy {
    void operator()(State* state) const;
  };
  std::unique_ptr<State, Destroy> state_;
};

}  // namespace facet::camera
