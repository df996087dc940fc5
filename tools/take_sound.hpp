#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sound/sound_export.hpp"
#include "take/reader.hpp"

namespace facet::tools {

/// Writes a take's sound from its first selected frame with a mesh, at which animations begin, to the end of
/// its last frame, and says what it wrote; of a take without a mesh from the first frame. Sample 0 is at that
/// frame's time. indices: in the take, rising, at least one. Throws as sound::write_sound.
void export_sound(take::TakeReader& take, const std::vector<std::int64_t>& indices,
                  sound::SoundEncoding encoding, const std::string& output);

/// Prints the lines of `facet summary` about a take's timecode and sound.
void print_time(take::TakeReader& take);

/// Frames a second that a take's source had, by its numbers; 30 where that can't be told.
double source_rate_hz(take::TakeReader& take);

}  // namespace facet::tools
