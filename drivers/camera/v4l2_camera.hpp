#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "camera/v4l2_kernel.hpp"

namespace facet::camera {

/// A camera of the Linux kernel, streamed through mapped buffers.
///
/// Its device may be absent, busy or broken at any time: `next` looks for it every quarter of a second, or
/// opens it anew with pauses that grow to two seconds, and a device that is silent for
/// LiveConfig::stall_after is started anew. Frame::sequence goes on with a gap. What the device offers is
/// checked against the configuration before anything is set.
///
/// Frame::timestamp_ns is the driver's, where it makes sense: CLOCK_MONOTONIC or CLOCK_REALTIME (converted),
/// else the time of arrival. A driver that stamps the end of a frame gets its times set back by a frame
/// period.
///
/// Throws Error(Usage) where the device is there and can't do what the configuration asks; the message lists
/// what it can. The kernel outlives the camera.
std::unique_ptr<Camera> open_v4l2_camera(const LiveConfig& config, V4l2Kernel& kernel = system_v4l2_kernel());

extern const CameraKind kV4l2Camera;

/// A capture device for people.
struct V4l2Description {
  std::string path;
  std::string card;
  std::string modes;     ///< what it offers, or why it can't be read
  std::string controls;  ///< that can be set by name, and what each takes; empty where there are none
};

/// The devices video* of a folder that deliver pictures, or that can't be opened to find out.
std::vector<V4l2Description> list_v4l2_devices(const std::filesystem::path& folder = "/dev",
                                               V4l2Kernel& kernel = system_v4l2_kernel());

}  // namespace facet::camera
