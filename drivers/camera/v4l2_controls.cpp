#include "camera/v4l2_controls.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <linux/videodev2.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace facet::camera {
namespace {

/// A value that a device can also regulate by itself.
struct Regulated {
  const char* key;
  std::optional<int> LiveConfig::*setting;
  int unit;  ///< of the configuration, in one of the device
  std::uint32_t value_id;
  std::uint32_t auto_id;
  std::array<int, 2> automatic;  ///< values of auto_id, the best first
  std::array<int, 2> manual;
};

constexpr int kExposureUnit_us = 100;
constexpr std::array kRegulated = {
    Regulated{"exposure_us",
              &LiveConfig::exposure_us,
              kExposureUnit_us,
              V4L2_CID_EXPOSURE_ABSOLUTE,
              V4L2_CID_EXPOSURE_AUTO,
              {V4L2_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY},
              {V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_SHUTTER_PRIORITY}},
    Regulated{"gain", &LiveConfig::gain, 1, V4L2_CID_GAIN, V4L2_CID_AUTOGAIN, {1, 1}, {0, 0}},
    Regulated{"white_balance_k",
              &LiveConfig::white_balance_k,
              1,
              V4L2_CID_WHITE_BALANCE_TEMPERATURE,
              V4L2_CID_AUTO_WHITE_BALANCE,
              {1, 1},
              {0, 0}},
};

std::optional<v4l2_queryctrl> find(const V4l2Request& request, std::uint32_t id) {
  v4l2_queryctrl control{};
  control.id = id;
  if (!request(VIDIOC_QUERYCTRL, &control) || (control.flags & V4L2_CTRL_FLAG_DISABLED) != 0) {
    return std::nullopt;
  }
  return control;
}

/// The first of the values that a menu has, or that a switch takes.
std::optional<int> first_offered(const V4l2Request& request, const v4l2_queryctrl& control,
                                 const std::array<int, 2>& values) {
  for (const int value : values) {
    v4l2_querymenu entry{};
    entry.id = control.id;
    entry.index = static_cast<std::uint32_t>(value);
    if (control.type != V4L2_CTRL_TYPE_MENU || request(VIDIOC_QUERYMENU, &entry)) {
      return value;
    }
  }
  return std::nullopt;
}

std::string range(const Regulated& regulated, const v4l2_queryctrl& control) {
  return fmt::format("{} to {} in steps of {}", std::int64_t{control.minimum} * regulated.unit,
                     std::int64_t{control.maximum} * regulated.unit,
                     std::int64_t{control.step} * regulated.unit);
}

std::string describe_controls(const V4l2Request& request) {
  std::vector<std::string> found;
  for (const Regulated& regulated : kRegulated) {
    if (const auto control = find(request, regulated.value_id)) {
      found.push_back(fmt::format("{} {}", regulated.key, range(regulated, *control)));
    }
  }
  return found.empty() ? "none of exposure, gain and white balance"
                       : fmt::format("{}", fmt::join(found, ", "));
}

bool set(const V4l2Request& request, std::uint32_t id, int value) {
  v4l2_control control{id, value};
  return request(VIDIOC_S_CTRL, &control);
}

}  // namespace

std::string check_controls(const LiveConfig& config, const V4l2Request& request) {
  for (const Regulated& regulated : kRegulated) {
    const std::optional<int> wanted = config.*regulated.setting;
    if (!wanted) {
      continue;
    }
    const auto control = find(request, regulated.value_id);
    if (!control) {
      return fmt::format("source.{} can't be set; the device lets set: {}", regulated.key,
                         describe_controls(request));
    }
    const int value = *wanted / regulated.unit;
    if (value < control->minimum || value > control->maximum) {
      return fmt::format("source.{} = {}: the device takes {}", regulated.key, *wanted,
                         range(regulated, *control));
    }
  }
  return {};
}

std::string set_controls(const LiveConfig& config, const V4l2Request& request) {
  for (const Regulated& regulated : kRegulated) {
    const std::optional<int> wanted = config.*regulated.setting;
    if (const auto control = find(request, regulated.auto_id)) {
      if (const auto mode =
              first_offered(request, *control, wanted ? regulated.manual : regulated.automatic)) {
        set(request, regulated.auto_id, *mode);
      }
    }
    if (wanted && !set(request, regulated.value_id, *wanted / regulated.unit)) {
      return fmt::format("source.{} = {}: the device does not take it", regulated.key, *wanted);
    }
  }
  // In the dark a longer exposure must not cost frames.
  if (!config.exposure_us && find(request, V4L2_CID_EXPOSURE_AUTO_PRIORITY)) {
    set(request, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0);
  }
  return {};
}

}  // namespace facet::camera
