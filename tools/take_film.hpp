#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "stop_signals.hpp"
#include "take/reader.hpp"

namespace facet::tools {

struct FilmOptions {
  std::string panels;  ///< report::parse_film_panels; empty: what the take has of picture, grey and skin
  std::string video;   ///< a video or take whose pictures are shown; empty: the take's own or its source's
  int height_px = 720;
  std::string output;
};

/// Writes a take's frames as a film (render::VideoCodec::Film) that begins at the first selected frame, with
/// the sound and timecode of the take where it has them, and says what it wrote. At a constant rate a number
/// of the source that the take lacks holds the picture before it; at a varying one each picture is shown at
/// its own time. indices: in the take, rising, at least one. Returns the signal that broke it off, or 0.
/// Throws as report::FilmPainter, render::VideoWriter and sound::SoundReader do.
int export_film(take::TakeReader& take, const std::vector<std::int64_t>& indices, const FilmOptions& options,
                const StopSignals& signals);

}  // namespace facet::tools
