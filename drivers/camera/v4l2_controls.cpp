#include "camera/v4l2_controls.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <utility>
#include <variant>
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

/// A driver's lists are read no further than this.
constexpr std::uint32_t kLongestList = 1024;

using Value = decltype(ControlSetting::value);

/// A control that can be set by its name.
struct NamedControl {
  v4l2_query_ext_ctrl query{};
  std::string name;
  /// Of menus: what stands for each entry, in the configuration's words, and its index.
  std::vector<std::pair<Value, std::int64_t>> menu;
};

template <typename Text>
std::string text_of(const Text& field) {
  const auto* letters = reinterpret_cast<const char*>(field);
  return {letters, ::strnlen(letters, sizeof field)};
}

void read_menu(const V4l2Request& request, NamedControl& control) {
  // A menu begins at 0 or 1.
  for (std::uint32_t index = 0; index < kLongestList && index <= control.query.maximum; ++index) {
    v4l2_querymenu entry{};
    entry.id = control.query.id;
    entry.index = index;
    if (request(VIDIOC_QUERYMENU, &entry)) {
      if (control.query.type == V4L2_CTRL_TYPE_MENU) {
        control.menu.emplace_back(text_of(entry.name), index);
      } else {
        control.menu.emplace_back(std::int64_t{entry.value}, index);
      }
    }
  }
}

bool can_be_set(const v4l2_query_ext_ctrl& query) {
  switch (query.type) {
    case V4L2_CTRL_TYPE_INTEGER:
    case V4L2_CTRL_TYPE_INTEGER64:
    case V4L2_CTRL_TYPE_BOOLEAN:
    case V4L2_CTRL_TYPE_BITMASK:
    case V4L2_CTRL_TYPE_MENU:
    case V4L2_CTRL_TYPE_INTEGER_MENU:
      return (query.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY)) == 0;
    default:
      return false;  // titles of groups, buttons, texts, arrays
  }
}

std::vector<NamedControl> list_controls(const V4l2Request& request) {
  std::vector<NamedControl> found;
  v4l2_query_ext_ctrl query{};
  for (std::uint32_t last = 0; found.size() < kLongestList; last = query.id) {
    query = {};
    query.id = last | V4L2_CTRL_FLAG_NEXT_CTRL;
    if (!request(VIDIOC_QUERY_EXT_CTRL, &query) || query.id <= last) {
      break;
    }
    if (can_be_set(query)) {
      NamedControl& control = found.emplace_back();
      control.query = query;
      control.name = text_of(query.name);
      if (query.type == V4L2_CTRL_TYPE_MENU || query.type == V4L2_CTRL_TYPE_INTEGER_MENU) {
        read_menu(request, control);
      }
    }
  }
  return found;
}

std::string describe(const Value& value) {
  if (const bool* on = std::get_if<bool>(&value)) {
    return *on ? "true" : "false";
  }
  if (const std::int64_t* number = std::get_if<std::int64_t>(&value)) {
    return std::to_string(*number);
  }
  return fmt::format("\"{}\"", std::get<std::string>(value));
}

std::string what_it_takes(const NamedControl& control) {
  const v4l2_query_ext_ctrl& query = control.query;
  switch (query.type) {
    case V4L2_CTRL_TYPE_BOOLEAN:
      return "true or false";
    case V4L2_CTRL_TYPE_BITMASK:
      return fmt::format("bits of 0x{:X}", static_cast<std::uint32_t>(query.maximum));
    case V4L2_CTRL_TYPE_MENU:
    case V4L2_CTRL_TYPE_INTEGER_MENU: {
      std::vector<std::string> entries;
      for (const auto& [value, index] : control.menu) {
        entries.push_back(describe(value));
      }
      return fmt::format("one of {}", fmt::join(entries, ", "));
    }
    default:
      return fmt::format("{} to {}{}", query.minimum, query.maximum,
                         query.step > 1 ? fmt::format(" in steps of {}", query.step) : "");
  }
}

std::string describe_all(const std::vector<NamedControl>& controls) {
  std::vector<std::string> texts;
  texts.reserve(controls.size());
  for (const NamedControl& control : controls) {
    texts.push_back(fmt::format("{} {}", control_key(control.name), what_it_takes(control)));
  }
  return fmt::format("{}", fmt::join(texts, "; "));
}

/// What the driver is told for a value; none where the control does not take it.
std::optional<std::int64_t> in_driver_terms(const NamedControl& control, const ControlSetting& setting) {
  const v4l2_query_ext_ctrl& query = control.query;
  if (query.type == V4L2_CTRL_TYPE_MENU || query.type == V4L2_CTRL_TYPE_INTEGER_MENU) {
    const auto entry = std::find_if(control.menu.begin(), control.menu.end(),
                                    [&](const auto& other) { return other.first == setting.value; });
    return entry == control.menu.end() ? std::nullopt : std::optional(entry->second);
  }
  if (query.type == V4L2_CTRL_TYPE_BOOLEAN) {
    const bool* on = std::get_if<bool>(&setting.value);
    return on == nullptr ? std::nullopt : std::optional<std::int64_t>(*on ? 1 : 0);
  }
  const std::int64_t* number = std::get_if<std::int64_t>(&setting.value);
  if (number == nullptr) {
    return std::nullopt;
  }
  if (query.type == V4L2_CTRL_TYPE_BITMASK) {
    const auto allowed = static_cast<std::int64_t>(static_cast<std::uint32_t>(query.maximum));
    return (*number & ~allowed) == 0 ? std::optional(*number) : std::nullopt;
  }
  if (*number < query.minimum || *number > query.maximum) {
    return std::nullopt;
  }
  const std::uint64_t above = static_cast<std::uint64_t>(*number) - static_cast<std::uint64_t>(query.minimum);
  return query.step > 1 && above % query.step != 0 ? std::nullopt : std::optional(*number);
}

std::string key_of(const ControlSetting& setting) {
  return fmt::format("source.controls.{} = {}", control_key(setting.name), describe(setting.value));
}

/// A setting of the configuration and the control that it is for, or what is wrong with it.
struct Match {
  const NamedControl* control = nullptr;
  std::int64_t value = 0;
  std::string fault;
};

Match match(const std::vector<NamedControl>& controls, const ControlSetting& setting) {
  Match found;
  for (const NamedControl& control : controls) {
    if (control_key(control.name) == control_key(setting.name)) {
      if (found.control != nullptr) {
        found.fault = key_of(setting) + ": the device has several controls of this name";
        return found;
      }
      found.control = &control;
    }
  }
  if (found.control == nullptr) {
    found.fault = fmt::format("{}: the device has no such control; it has: {}", key_of(setting),
                              controls.empty() ? "none" : describe_all(controls));
  } else if (const auto value = in_driver_terms(*found.control, setting)) {
    found.value = *value;
  } else {
    found.fault = fmt::format("{}: the device takes {}", key_of(setting), what_it_takes(*found.control));
  }
  return found;
}

/// Returns what the device refused; empty where nothing.
std::string set_named(const V4l2Request& request, const Match& wanted, const ControlSetting& setting) {
  v4l2_ext_control control{};
  control.id = wanted.control->query.id;
  const bool wide = wanted.control->query.type == V4L2_CTRL_TYPE_INTEGER64;
  if (wide) {
    control.value64 = wanted.value;
  } else {
    control.value = static_cast<std::int32_t>(wanted.value);
  }
  v4l2_ext_controls controls{};
  controls.which = V4L2_CTRL_WHICH_CUR_VAL;
  controls.count = 1;
  controls.controls = &control;
  if (!request(VIDIOC_S_EXT_CTRLS, &controls)) {
    return key_of(setting) +
           ": the device does not take it now; another control may have to be set before it";
  }
  const std::int64_t given = wide ? control.value64 : control.value;
  if (given != (wide ? wanted.value : static_cast<std::int32_t>(wanted.value))) {
    return fmt::format("{}: the device made it {}", key_of(setting), given);
  }
  return {};
}

}  // namespace

std::string control_key(std::string_view name) {
  std::string key;
  for (const char c : name) {
    if ((c >= '0' && c <= '9') || (c >= 'a' && c <= 'z')) {
      key += c;
    } else if (c >= 'A' && c <= 'Z') {
      key += static_cast<char>(c - 'A' + 'a');
    } else if (!key.empty() && key.back() != '_') {
      key += '_';
    }
  }
  return key.ends_with('_') ? key.substr(0, key.size() - 1) : key;
}

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
  if (config.controls.empty()) {
    return {};
  }
  const std::vector<NamedControl> controls = list_controls(request);
  for (const ControlSetting& setting : config.controls) {
    const Match wanted = match(controls, setting);
    if (!wanted.fault.empty()) {
      return wanted.fault;
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
  for (const ControlSetting& setting : config.controls) {
    // Anew for each: what one control takes may depend on another.
    const std::vector<NamedControl> controls = list_controls(request);
    const Match wanted = match(controls, setting);
    std::string refused = wanted.fault.empty() ? set_named(request, wanted, setting) : wanted.fault;
    if (!refused.empty()) {
      return refused;
    }
  }
  return {};
}

std::string describe_named_controls(const V4l2Request& request) {
  return describe_all(list_controls(request));
}

}  // namespace facet::camera
