// facet-camera-host: a process with one camera in it, started by facetd and facet. Also: --list.

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "camera/device_fault.hpp"
#include "camera/host_sandbox.hpp"
#include "camera/host_service.hpp"
#ifdef FACET_LIBCAMERA
#include "camera/libcamera_camera.hpp"
#endif

namespace {

using facet::camera::CameraConfig;
using facet::camera::CameraListing;
using facet::camera::DeviceFault;

std::unique_ptr<facet::Camera> open_camera(const CameraConfig& config) {
#ifdef FACET_LIBCAMERA
  if (config.kind == "libcamera") {
    return facet::camera::open_libcamera_camera(config);
  }
#endif
  throw DeviceFault(DeviceFault::Kind::Unsuitable,
                    "this build of Facet has no cameras of kind \"" + config.kind + "\"");
}

std::vector<CameraListing> list_cameras() {
#ifdef FACET_LIBCAMERA
  return facet::camera::list_libcamera_cameras();
#else
  return {};
#endif
}

/// Settings of libcamera's algorithms that a person changed, and devices: libcamera looks at each that comes
/// while it runs, under a name that nobody knows before, and crashes where it may not. Which of /dev there
/// are is for the file rights of the daemon's user, and under systemd for the unit's DeviceAllow.
facet::camera::HostReach reach() {
  facet::camera::HostReach reach;
  reach.readable = {"/etc/libcamera"};
  reach.devices = {"/dev"};
  return reach;
}

}  // namespace

#ifdef FACET_SANITIZED
// Looking for leaks takes what a confined process can't do: a second process that stops the first.
// NOLINTNEXTLINE(bugprone-reserved-identifier): the name that the sanitizer looks for
extern "C" int __lsan_is_turned_off() {
  return 1;
}
#endif

int main(int argc, char** argv) {
  // libcamera tells each step otherwise, and warns of every kind of camera that is not there.
  ::setenv("LIBCAMERA_LOG_LEVELS", "*:ERROR", 0);
  return facet::camera::run_camera_host(argc, argv, {open_camera, list_cameras, reach});
}
