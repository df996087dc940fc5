#pragma once

#include <memory>
#include <vector>

#include "camera/factory.hpp"
#include "camera/host_service.hpp"

namespace facet::camera {

// Only the camera host links this: pipeline handlers run in its process.

/// A camera that libcamera drives. It is opened once: whatever goes wrong then is its last state, Absent or
/// Failing.
///
/// Frame::timestamp_ns is SensorTimestamp, the start of the first row's exposure, where there is one. It is
/// defined as CLOCK_BOOTTIME, yet handlers that pass on what the kernel stamps (USB cameras) give
/// CLOCK_MONOTONIC; the two differ by the time that the machine was suspended, so the one that fits is taken.
///
/// Throws DeviceFault: Absent, Failing, or Unsuitable where the camera can't do what the configuration asks.
/// One at a time in a process.
std::unique_ptr<Camera> open_libcamera_camera(const CameraConfig& config);

/// The cameras that libcamera finds, with what they offer. Throws DeviceFault(Failing).
std::vector<CameraListing> list_libcamera_cameras();

}  // namespace facet::camera
