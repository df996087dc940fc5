#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/camera.hpp"

namespace facet::camera {

// The inside of a camera host; its parent is a ContainedCamera.

/// A camera that there is.
struct CameraListing {
  std::string id;
  std::string description;  ///< what it is and what it offers, or why it can't be used
};

/// What a host program knows. Both throw DeviceFault, or Error.
struct HostedCameras {
  std::function<std::unique_ptr<Camera>(const CameraConfig& config)> open;
  std::function<std::vector<CameraListing>()> list;
};

/// The main function of a host program. Without --parent it is run by a person: `--list` prints the cameras.
/// With it, it talks to a parent over kHostSocket: lists the cameras (--list), opens one and says so
/// (--check), or hands over frames until the parent closes the socket. Ends with its parent, whatever hangs.
///
/// returns  the exit status
int run_camera_host(int argc, const char* const* argv, const HostedCameras& cameras);

/// The arguments that make a host open the camera of a configuration, and their reading.
std::vector<std::string> host_arguments(const CameraConfig& config);

}  // namespace facet::camera
