#pragma once

#include <functional>
#include <string>

#include "camera/factory.hpp"

namespace facet::camera {

/// Carries out a request of V4L2; false where the driver does not know it.
using V4l2Request = std::function<bool(unsigned long request, void* argument)>;

/// Checks the controls of a configuration against what a device has. Returns what is wrong, with what the
/// device offers instead; empty where all is well.
std::string check_controls(const LiveConfig& config, const V4l2Request& request);

/// Sets them, after a check. Returns what the device refused; empty where nothing.
std::string set_controls(const LiveConfig& config, const V4l2Request& request);

}  // namespace facet::camera
