#pragma once

#include <vector>

#include "stereo_footage.hpp"

namespace facet::bench {

/// Frame-by-frame window matching [SF04 eq. 1]: the disparity whose gain-bias error over 9 x 5 px is least,
/// with a parabola's fraction and a left-right check. [slots][height][width] mm, 0 in holes; empty for blank
/// slots.
std::vector<std::vector<float>> match_windows(const StereoFootage& footage);

/// OpenCV's StereoSGBM on the same rectified pictures: of a set of settings the one with the least median
/// error against truth. As above.
std::vector<std::vector<float>> match_sgbm(const StereoFootage& footage);

/// Local spacetime stereo [SF04 eq. 4] by the book: each pixel warps all samples of its own window by its own
/// d, dx, dy, dt and takes its own Gauss-Newton steps, in double precision, from the matcher's last pictures
/// and start values. The yardstick of the product's separable local method. Judged slots only; disparities, 0
/// where not solved.
std::vector<std::vector<float>> match_local_direct(const StereoFootage& footage,
                                                   const stereo::StereoMatcher& matcher,
                                                   const stereo::SpacetimeOptions& options);

}  // namespace facet::bench
