#include "refine/refiner.hpp"

namespace facet::refine {

void choose_detail(Detail detail, RefinerConfig& config) {
  constexpr Weights kFaithful;
  const bool expressive = detail == Detail::Expressive;
  config.weights.displacement_smooth = expressive ? 5 : kFaithful.displacement_smooth;
  config.weights.displacement_smooth_known = expressive ? 10 : kFaithful.displacement_smooth_known;
  config.weights.displacement_hierarchy = expressive ? 0.1F : kFaithful.displacement_hierarchy;
}

}  // namespace facet::refine
