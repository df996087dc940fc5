#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "take/reader.hpp"

namespace facet::tools {

/// Help of every --frames that takes a range.
inline constexpr const char* kFramesHelp =
    "Frames A:B of the source, from number A up to but not including B; either may be left out";

/// Frames are named by their number in the source, Frame::sequence, in every command: a take that begins at
/// frame 100 of a video has frames 100, 101 ... Returns the indices in the take of the frames "A:B", in
/// order; an empty text is all. Throws Error(Usage) where the text is no range or the take has no such frame.
std::vector<std::int64_t> frames_in_range(take::TakeReader& take, const std::string& text);

}  // namespace facet::tools
