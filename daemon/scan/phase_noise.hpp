#pragma once

#include <vector>

#include "scan/phase_decoder.hpp"

namespace facet::scan {

/// Of one pixel: I_k = mean + modulation cos(phase - 2 pi k / N).
struct Sine {
  float mean = 0;
  float modulation = 0;
  float phase = 0;  ///< -pi to pi
  float rest = 0;   ///< sum of the squares of what is no sine; 0 for three shifts
};

/// Standard deviation of grey over grey (0 to 1, in 16 bins), from what is no sine: the median of its
/// variance, by which n - 3 degrees of freedom are (1 - 2 / (9 dof))^3 of the mean [WH31].
///
/// sines, fault  [pixels]; of shifts pictures
/// assumed       where too little is seen to tell
std::vector<float> grey_noise(const std::vector<Sine>& sines, int shifts,
                              const std::vector<PhaseFault>& fault, float assumed);

/// A pixel that agrees with none of its neighbours is in the wrong period or on no surface.
void drop_lonely(PhaseField& field, std::vector<PhaseFault>& fault);

/// Mean over pairs of pixels that lie opposite of each other and whose own mean is the middle's within noise:
/// on one surface, and not bent. reach: of the pairs, px; 0: nothing is done.
void smooth(PhaseField& field, int reach);

}  // namespace facet::scan
