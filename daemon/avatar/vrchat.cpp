#include "avatar/vrchat.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <map>
#include <string_view>

#include "avatar/sent_values.hpp"

namespace facet::avatar {
namespace {

constexpr float kDegreesPerRadian = 57.29578F;
constexpr const char* kRoot = "/avatar/parameters/";
constexpr std::array kActive = {"EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive"};
constexpr std::string_view kNegative = "Negative";
constexpr unsigned kMostBits = 16;

/// A bool's name taken apart: of "FT/v2/JawOpen4" "FT/v2/JawOpen" and 2, of "...Negative" the sign.
struct BinaryName {
  std::string_view base;
  unsigned bit = 0;
  bool is_sign = false;
};
std::optional<BinaryName> binary_name(std::string_view name) {
  if (name.ends_with(kNegative)) {
    return BinaryName{name.substr(0, name.size() - kNegative.size()), 0, true};
  }
  const std::size_t digits = name.find_last_not_of("0123456789") + 1;
  unsigned number = 0;
  const auto [read, fault] = std::from_chars(name.data() + digits, name.data() + name.size(), number);
  if (fault != std::errc() || name[digits] == '0' || !std::has_single_bit(number) ||
      number >= 1U << kMostBits) {
    return std::nullopt;
  }
  return BinaryName{name.substr(0, digits), static_cast<unsigned>(std::countr_zero(number)), false};
}

/// NAME of "v2/NAME" and "ANYTHING/v2/NAME"; empty where it is neither.
std::string_view unified_name(std::string_view name) {
  constexpr std::string_view kVersion = "v2/";
  const std::size_t slash = name.rfind('/');
  const std::size_t at = slash == std::string_view::npos ? 0 : slash + 1;
  const std::string_view before = name.substr(0, at);
  const bool fits = before == kVersion || before.ends_with("/v2/");
  return fits ? name.substr(at) : std::string_view();
}

}  // namespace

bool BinaryPart::of(float value) const {
  constexpr float kWhole = 0.99999F;
  if (is_sign) {
    return value < 0;
  }
  if (value < 0 && !has_sign) {
    return false;
  }
  const float size = std::abs(value);
  return size > kWhole || (static_cast<unsigned>(std::ldexp(size, bits)) >> bit & 1U) != 0;
}

VrChatWriter::VrChatWriter(const MappedValues& chosen, const AvatarParameters* avatar) {
  if (avatar != nullptr) {
    take_avatar(chosen, *avatar);
    return;
  }
  MappedValues all;
  for (const char* prefix : {"v2/", "FT/v2/"}) {
    for (const MappedValue& value : unified_expressions()) {
      all.push_back({prefix + value.name, value.formula});
    }
  }
  for (MappedValue& value : replaced(std::move(all), chosen)) {
    values_.push_back({std::move(value.formula), {{kRoot + value.name}}});
  }
  for (const char* name : kActive) {
    active_addresses_.push_back(std::string(kRoot) + name);
  }
}

/// A name that was chosen takes its formula as a float, whatever its type: VRChat turns it into that. All
/// else is a float, or a bool of several, of a Unified Expression.
void VrChatWriter::take_avatar(const MappedValues& chosen, const AvatarParameters& avatar) {
  std::map<std::string, Formula, std::less<>> unified;
  for (const MappedValue& value : unified_expressions()) {
    unified.emplace(value.name, value.formula);
  }
  const auto chosen_of = [&](std::string_view name) -> const Formula* {
    const auto found =
        std::find_if(chosen.begin(), chosen.end(), [&](const MappedValue& one) { return one.name == name; });
    return found != chosen.end() ? &found->formula : nullptr;
  };
  const auto formula_of = [&](std::string_view name) {
    const Formula* const own = chosen_of(name);
    const auto found = own == nullptr ? unified.find(unified_name(name)) : unified.end();
    return found != unified.end() ? &found->second : own;
  };
  std::map<std::string, std::size_t, std::less<>> places;  // in values_, by the float's name
  const auto value_of = [&](std::string_view name, const Formula& formula) -> Value& {
    const auto [place, is_new] = places.try_emplace(std::string(name), values_.size());
    return is_new ? values_.emplace_back(Value{formula, {}}) : values_[place->second];
  };
  for (const AvatarParameter& parameter : avatar.list) {
    const std::string address = kRoot + parameter.name;
    const std::string_view last = std::string_view(address).substr(address.rfind('/') + 1);
    if (const Formula* const own = chosen_of(parameter.name)) {
      value_of(parameter.name, *own).outputs.push_back({address});
    } else if (parameter.type == 'T' && std::find(kActive.begin(), kActive.end(), last) != kActive.end()) {
      active_addresses_.push_back(address);
    } else if (parameter.type == 'f') {
      if (const Formula* const formula = formula_of(parameter.name)) {
        value_of(parameter.name, *formula).outputs.push_back({address});
      }
    } else if (const auto name = parameter.type == 'T' ? binary_name(parameter.name) : std::nullopt) {
      if (const Formula* const formula = formula_of(name->base)) {
        value_of(name->base, *formula).outputs.push_back({address, BinaryPart{name->bit, name->is_sign}});
      }
    }
  }
  for (Value& value : values_) {
    unsigned bits = 0;
    bool has_sign = false;
    for (const Output& output : value.outputs) {
      bits |= output.part && !output.part->is_sign ? 1U << output.part->bit : 0U;
      has_sign = has_sign || (output.part && output.part->is_sign);
    }
    for (Output& output : value.outputs) {
      if (output.part) {
        output.part->bits = std::popcount(bits);
        output.part->has_sign = has_sign;
      }
    }
    driven_ += static_cast<int>(value.outputs.size());
  }
  driven_ += static_cast<int>(active_addresses_.size());
}

void VrChatWriter::write(const FaceState& state, float time_s, OscBundles& out) {
  const bool all = !active_ || time_s - all_sent_s_ >= kAllEvery_s;
  if (all) {
    all_sent_s_ = time_s;
  }
  const bool active = state.tracked && state.has_expression;
  if (all || active_ != active) {
    for (const std::string& address : active_addresses_) {
      out.add(address, {active});
    }
    active_ = active;
  }
  if (!active) {
    return;
  }
  for (Value& value : values_) {
    const float number = std::clamp(value.formula.of(state.values), -1.0F, 1.0F);
    for (Output& output : value.outputs) {
      const bool part = output.part && output.part->of(number);
      const float sent = !output.part ? number : part ? 1.0F : 0.0F;
      if (all || !output.sent || std::abs(sent - *output.sent) >= kLeastChange) {
        out.add(output.address, {output.part ? OscArgument(part) : OscArgument(sent)});
        output.sent = sent;
      }
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
