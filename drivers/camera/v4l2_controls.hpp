#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "camera/factory.hpp"

namespace facet::camera {

/// Carries out a request of V4L2; false where the driver does not know it or does not take the value.
using V4l2Request = std::function<bool(unsigned long request, void* argument)>;

/// The name of a control as V4L2's tools spell it: in lower case, with one underscore for whatever is no
/// letter or digit, and none at the ends ("White Balance, Automatic" is white_balance_automatic).
std::string control_key(std::string_view name);

/// Checks the controls of a configuration against what a device has. Returns what is wrong, with what the
/// device offers instead; empty where all is well.
std::string check_controls(const LiveConfig& config, const V4l2Request& request);

/// Sets them, after a check. Returns what the device refused; empty where nothing.
std::string set_controls(const LiveConfig& config, const V4l2Request& request);

/// The controls that LiveConfig::controls can set, with what each takes, for people; empty where there are
/// none.
std::string describe_named_controls(const V4l2Request& request);

}  // namespace facet::camera
