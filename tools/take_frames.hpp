#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "exports/export.hpp"
#include "pipeline/frame_range.hpp"
#include "take/reader.hpp"

namespace facet::tools {

/// Help of every --frames that takes a range.
inline constexpr const char* kFramesHelp =
    "Frames A:B of the source, from number A up to but not including B; either may be left out";

/// Frames are named by their number in the source, Frame::sequence, in every command: a take that begins at
/// frame 100 of a video has frames 100, 101 ... Returns the indices in the take of the frames "A:B", in
/// order; an empty text is all. Throws Error(Usage) where the text is no range or the take has no such frame.
std::vector<std::int64_t> frames_in_range(take::TakeReader& take, const std::string& text);

/// exports::make_timeline of the frames at these indices in the take, at least one.
exports::Timeline timeline_of(take::TakeReader& take, const std::vector<std::int64_t>& indices);

/// Warns on standard error where the source's rate varies: for what holds a frame for each of the source's
/// without its time. output: the file or folder that is written.
void warn_of_varying_rate(const exports::Timeline& timeline, const std::string& output);

/// Indices of the slots of a range that a take has. Throws Error(UnreadableInput) where it has none of them,
/// or no pictures.
std::vector<std::int64_t> slots_of(take::TakeReader& take, const pipeline::FrameRange& range);

}  // namespace facet::tools
