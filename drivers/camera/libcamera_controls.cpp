#include "camera/libcamera_controls.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <optional>
#include <vector>

#include "camera/device_fault.hpp"

namespace facet::camera {
namespace {

using libcamera::ControlId;
using libcamera::ControlInfoMap;
using libcamera::ControlList;
using libcamera::ControlValue;

/// ExposureTimeMode and AnalogueGainMode of libcamera 0.5 and newer.
constexpr std::int32_t kModeAuto = 0;
constexpr std::int32_t kModeManual = 1;

/// The first number of a value.
template <typename Number>
double first_as(const ControlValue& value) {
  Number number{};
  const auto data = value.data();
  if (data.size() < sizeof number) {
    return 0;
  }
  std::memcpy(&number, data.data(), sizeof number);
  return static_cast<double>(number);
}

double first_number(const ControlValue& value) {
  switch (value.type()) {
    case libcamera::ControlTypeBool:
      return first_as<bool>(value);
    case libcamera::ControlTypeByte:
      return first_as<std::uint8_t>(value);
    case libcamera::ControlTypeInteger32:
      return first_as<std::int32_t>(value);
    case libcamera::ControlTypeInteger64:
      return first_as<std::int64_t>(value);
    case libcamera::ControlTypeFloat:
      return first_as<float>(value);
    default:
      return 0;
  }
}

/// A control that a camera offers, with its range.
struct Offered {
  const ControlId* id;
  double least;
  double most;
};

std::optional<Offered> find(const ControlInfoMap& controls, const char* name) {
  for (const auto& [id, info] : controls) {
    if (id->name() == name) {
      return Offered{id, first_number(info.min()), first_number(info.max())};
    }
  }
  return std::nullopt;
}

/// A number as the type that the control has.
ControlValue typed(const ControlId& id, double value) {
  switch (id.type()) {
    case libcamera::ControlTypeBool:
      return ControlValue(value != 0);
    case libcamera::ControlTypeInteger32:
      return ControlValue(static_cast<std::int32_t>(std::lround(value)));
    case libcamera::ControlTypeInteger64:
      return ControlValue(static_cast<std::int64_t>(std::llround(value)));
    default:
      return ControlValue(static_cast<float>(value));
  }
}

/// A key of the configuration, what it is called in libcamera, and in what unit.
struct Key {
  const char* key;
  const char* control;
};
constexpr Key kExposure{"exposure_us", "ExposureTime"};
constexpr Key kGain{"gain", "AnalogueGain"};
constexpr Key kWhiteBalance{"white_balance_k", "ColourTemperature"};
constexpr Key kColourGains{"red_gain and blue_gain", "ColourGains"};
constexpr const char* kFrameDuration = "FrameDurationLimits";  // in us

[[noreturn]] void refuse(const std::string& what) {
  throw DeviceFault(DeviceFault::Kind::Unsuitable, what);
}

Offered demand(const ControlInfoMap& controls, const Key& key) {
  const auto found = find(controls, key.control);
  if (!found) {
    refuse(
        fmt::format("source.{} can't be set; the camera lets set: {}", key.key, describe_controls(controls)));
  }
  return *found;
}

void set(const ControlInfoMap& controls, const Key& key, double value, ControlList& list) {
  const Offered control = demand(controls, key);
  if (value < control.least || value > control.most) {
    refuse(fmt::format("source.{} = {}: the camera takes {:.6g} to {:.6g}", key.key, value, control.least,
                       control.most));
  }
  list.set(control.id->id(), typed(*control.id, value));
}

void set_switch(const ControlInfoMap& controls, const char* name, double value, ControlList& list) {
  if (const auto control = find(controls, name)) {
    list.set(control->id->id(), typed(*control->id, value));
  }
}

void set_exposure(const CameraConfig& config, const ControlInfoMap& controls, LibcameraControls& made) {
  const std::optional<int> exposure_us = config.live.exposure_us;
  const std::optional<double> gain = config.libcamera.gain;
  if (find(controls, "ExposureTimeMode")) {
    set_switch(controls, "ExposureTimeMode", exposure_us ? kModeManual : kModeAuto, made.switches);
    set_switch(controls, "AnalogueGainMode", gain ? kModeManual : kModeAuto, made.switches);
  } else {
    // One switch for both. A gain alone is held by setting it; a USB camera takes an exposure only without
    // it.
    set_switch(controls, "AeEnable", exposure_us ? 0 : 1, made.switches);
  }
  if (exposure_us) {
    set(controls, kExposure, *exposure_us, made.values);
  }
  if (gain) {
    set(controls, kGain, *gain, made.values);
  }
}

void set_white_balance(const CameraConfig& config, const ControlInfoMap& controls, LibcameraControls& made) {
  const std::optional<int> temperature_k = config.live.white_balance_k;
  const bool gains = config.libcamera.red_gain && config.libcamera.blue_gain;
  set_switch(controls, "AwbEnable", temperature_k || gains ? 0 : 1, made.switches);
  if (temperature_k) {
    set(controls, kWhiteBalance, *temperature_k, made.values);
  }
  if (gains) {
    const Offered control = demand(controls, kColourGains);
    const std::array<float, 2> both = {static_cast<float>(*config.libcamera.red_gain),
                                       static_cast<float>(*config.libcamera.blue_gain)};
    made.values.set(control.id->id(), ControlValue(libcamera::Span<const float>(both)));
  }
}

/// Not every camera lets its rate be set; then it is what the camera makes of the size.
void set_rate(const CameraConfig& config, const ControlInfoMap& controls, LibcameraControls& made) {
  constexpr double kTolerance = 0.01;  // 29.97 Hz is 30 Hz for who asks for it
  const auto control = find(controls, kFrameDuration);
  if (!control) {
    return;
  }
  const double duration_us = 1e6 / config.live.rate_hz;
  if (duration_us < control->least * (1 - kTolerance) || duration_us > control->most * (1 + kTolerance)) {
    refuse(fmt::format("source.rate_hz = {:.4g}: the camera takes {:.4g} to {:.4g}", config.live.rate_hz,
                       1e6 / control->most, 1e6 / control->least));
  }
  const std::array<std::int64_t, 2> limits = {std::llround(duration_us), std::llround(duration_us)};
  made.values.set(control->id->id(), ControlValue(libcamera::Span<const std::int64_t>(limits)));
}

}  // namespace

LibcameraControls make_controls(const CameraConfig& config, const ControlInfoMap& offered) {
  LibcameraControls made{ControlList(offered), ControlList(offered)};
  set_exposure(config, offered, made);
  set_white_balance(config, offered, made);
  set_rate(config, offered, made);
  return made;
}

std::string describe_controls(const ControlInfoMap& offered) {
  std::vector<std::string> texts;
  for (const Key& key : {kExposure, kGain, kWhiteBalance}) {
    if (const auto control = find(offered, key.control)) {
      texts.push_back(fmt::format("{} {:.6g} to {:.6g}", key.key, control->least, control->most));
    }
  }
  if (find(offered, kColourGains.control)) {
    texts.emplace_back(kColourGains.key);
  }
  if (const auto control = find(offered, kFrameDuration)) {
    texts.push_back(fmt::format("rate_hz {:.4g} to {:.4g}", 1e6 / control->most, 1e6 / control->least));
  }
  return texts.empty() ? "none of exposure, gain, white balance and rate"
                       : fmt::format("{}", fmt::join(texts, ", "));
}

}  // namespace facet::camera
