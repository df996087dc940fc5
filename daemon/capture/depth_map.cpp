#include "capture/depth_map.hpp"

#include <algorithm>
#include <iterator>

#include "maths/statistics.hpp"

namespace facet::capture {

void weigh_by_own_noise(std::span<DepthMap> maps) {
  std::vector<float> sigmas;
  for (const DepthMap& map : maps) {
    std::copy_if(map.sigma_mm.begin(), map.sigma_mm.end(), std::back_inserter(sigmas),
                 [](float sigma) { return sigma > 0; });
  }
  if (sigmas.empty()) {
    return;
  }
  const float middle_mm = maths::median_of(sigmas);
  for (DepthMap& map : maps) {
    std::transform(
        map.sigma_mm.begin(), map.sigma_mm.end(), map.confidence.begin(),
        [middle_mm](float sigma) { return sigma > 0 ? depth_confidence(sigma, middle_mm) : 0.0F; });
  }
}

}  // namespace facet::capture
