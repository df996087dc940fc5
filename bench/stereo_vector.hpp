#pragma once

#include <span>
#include <vector>

#include "stereo/spacetime_solver.hpp"

namespace facet::bench {

struct VectorStereoResult {
  std::vector<float> disparity_px;  ///< [slots][height][width]
  double windows_ms = 0;            ///< of a Gauss-Newton step, all slots: the windows' normal equations
  double solve_ms = 0;              ///< of a Gauss-Newton step, all slots: CG
  double cpu_ms = 0;                ///< of a Gauss-Newton step, all slots: CPU time of all threads
};

/// The global Gauss-Newton step (docs/stereo.md, S2 to S9) written for a CPU's vector units, as the yardstick
/// of the GPU path: loops along rows that compile to vector code, window sums tile by tile in the cache, CG
/// over the whole volume (one block), one thread for each core. left, right, start_px  as in
/// stereo::SpacetimeSolver
VectorStereoResult solve_on_vectors(const stereo::VolumeSize& size, std::span<const float> left,
                                    std::span<const float> right, std::span<const float> start_px,
                                    const stereo::SpacetimeOptions& options, int threads);

}  // namespace facet::bench
