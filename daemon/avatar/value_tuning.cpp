#include "avatar/value_tuning.hpp"

#include <algorithm>
#include <cmath>

namespace facet::avatar {

const ValueTuning& ValueTunings::of(std::size_t index) const {
  const auto found = named.find(index);
  return found == named.end() ? all : found->second;
}

void ValueTuner::apply(const ValueTunings& tunings, FaceState& state) {
  if (!state.tracked) {
    before_.reset();
    return;
  }
  const double elapsed_ms =
      before_ ? 1e-6 * static_cast<double>(state.timestamp_ns - before_->timestamp_ns) : 0;
  for (std::size_t i = 0; i < state.values.size(); ++i) {
    const ValueTuning& tuning = tunings.of(i);
    double value = (state.values.at(i) - tuning.dead_zone) / (1 - tuning.dead_zone);
    value = std::clamp(tuning.gain * std::max(0.0, value), 0.0, 1.0);
    if (before_ && tuning.smoothing_ms > 0) {
      const double share = 1 - std::exp(-std::max(0.0, elapsed_ms) / tuning.smoothing_ms);
      value = before_->values.at(i) + share * (value - before_->values.at(i));
    }
    state.values.at(i) = static_cast<float>(value);
  }
  before_ = {state.timestamp_ns, state.values};
}

}  // namespace facet::avatar
