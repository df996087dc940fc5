#pragma once

#include <cstdint>
#include <limits>
#include <string>

namespace facet::pipeline {

/// Frames [first, end) of a source, by Frame::sequence.
struct FrameRange {
  std::uint64_t first = 0;
  std::uint64_t end = std::numeric_limits<std::uint64_t>::max();
};

/// Reads "A:B" (half open; either side may be empty: "100:", ":50"); an empty text is every frame. Throws
/// Error(Usage) saying what is wrong with the text.
FrameRange parse_frame_range(const std::string& text);

}  // namespace facet::pipeline
