#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "camera/host_sandbox.hpp"
#include "facet/camera.hpp"

namespace facet::camera {

// The inside of a camera host; its parent is a ContainedCamera.

/// A camera that there is.
struct CameraListing {
  std::string id;
  std::string description;  ///< what it is and what it offers, or why it can't be used
};

/// What a host program knows. The first two throw DeviceFault, or Error, and run confined.
struct HostedCameras {
  std::function<std::unique_ptr<Camera>(const CameraConfig& config)> open;
  std::function<std::vector<CameraListing>()> list;
  std::function<HostReach()> reach;  ///< what they need of the file system; empty: nothing of its own
};

/// The main function of a host program. Without --parent it is run by a person: `--list` prints the cameras.
/// With it, it talks to a parent over kHostSocket: lists the cameras (--list), opens one and says so
/// (--check), or hands over frames until the parent closes the socket. Ends with its parent, whatever hangs.
/// All of it is confined (confine_host) before the first call of `open` or `list`: what a library did when it
/// was loaded came before.
///
/// returns  the exit status
int run_camera_host(int argc, const char* const* argv, const HostedCameras& cameras);

/// The arguments that make a host open the camera of a configuration, and their reading.
std::vector<std::string> host_arguments(const CameraConfig& config);

}  // namespace facet::camera
