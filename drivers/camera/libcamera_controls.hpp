#pragma once

#include <libcamera/controls.h>

#include <string>

#include "camera/factory.hpp"

namespace facet::camera {

/// What is to be set in a camera: switches from automatic to manual go with the first frame, values with the
/// second, because not every pipeline handler sets them in order within one.
struct LibcameraControls {
  libcamera::ControlList switches;
  libcamera::ControlList values;
};

/// The controls of a configuration for a camera that offers `offered`. Controls are found by their names, so
/// that those of libcamera 0.0.3 (AeEnable for exposure and gain) and of 0.5 (ExposureTimeMode,
/// AnalogueGainMode) both work. Throws DeviceFault(Unsuitable) that says what the camera offers instead.
LibcameraControls make_controls(const CameraConfig& config, const libcamera::ControlInfoMap& offered);

/// What of the configuration can be set, for people.
std::string describe_controls(const libcamera::ControlInfoMap& offered);

}  // namespace facet::camera
