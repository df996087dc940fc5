#pragma once

#include <vector>

#include "facet/frame_set.hpp"

namespace facet::bench {

/// Prints what lossless codecs make of the pictures, and what the steps of recording and reading them cost a
/// set: processor time of one thread, the best of several rounds.
void measure_codecs(const std::vector<FrameSet>& sets);
void measure_steps(const std::vector<FrameSet>& sets);

}  // namespace facet::bench
