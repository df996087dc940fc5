#include "avatar/vrchat.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "avatar/sent_values.hpp"

namespace facet::avatar {
namespace {

constexpr float kDegreesPerRadian = 57.29578F;

}  // namespace

VrChatWriter::VrChatWriter(const MappedValues& chosen) {
  const std::string root = "/avatar/parameters/";
  MappedValues all;
  for (const char* prefix : {"v2/", "FT/v2/"}) {
    for (const MappedValue& value : unified_expressions()) {
      all.push_back({prefix + value.name, value.formula});
    }
  }
  for (MappedValue& value : replaced(std::move(all), chosen)) {
    parameters_.push_back({root + value.name, std::move(value.formula), std::nullopt});
  }
}

void VrChatWriter::write(const FaceState& state, float time_s, OscBundles& out) {
  const bool all = !active_ || time_s - all_sent_s_ >= kAllEvery_s;
  if (all) {
    all_sent_s_ = time_s;
  }
  const bool active = state.tracked && state.has_expression;
  if (all || active_ != active) {
    for (const char* name : {"EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive"}) {
      out.add(std::string("/avatar/parameters/") + name, {active});
    }
    active_ = active;
  }
  if (!active) {
    return;
  }
  for (Parameter& parameter : parameters_) {
    const float value = std::clamp(parameter.formula.of(state.values), -1.0F, 1.0F);
    if (all || !parameter.sent || std::abs(value - *parameter.sent) >= kLeastChange) {
      out.add(parameter.address, {value});
      parameter.sent = value;
    }
  }
  const std::array<float, 9> angles =
      mesh::live_link_rotations(state.values, state.upright_from_head.linear());
  const auto degrees = [&](std::size_t i) { return kDegreesPerRadian * angles.at(i); };
  const float closed = (state.values.at(static_cast<std::size_t>(mesh::arkit_index("EyeBlinkLeft"))) +
                        state.values.at(static_cast<std::size_t>(mesh::arkit_index("EyeBlinkRight")))) /
                       2;
  out.add("/tracking/eye/EyesClosedAmount", {closed});
  out.add("/tracking/eye/LeftRightPitchYaw", {degrees(4), degrees(3), degrees(7), degrees(6)});
}

}  // namespace facet::avatar
