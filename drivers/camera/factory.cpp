#include "camera/factory.hpp"

#include "camera/contained_camera.hpp"
#include "camera/v4l2_camera.hpp"
#include "camera/video_file.hpp"
#include "facet/error.hpp"

namespace facet::camera {

bool names_source(const CameraConfig& config) {
  if (config.kind == "file") {
    return !config.path.empty();
  }
  return config.kind != "v4l2" || !config.live.device.empty();
}

std::unique_ptr<Camera> open_camera(const CameraConfig& config) {
  if (config.kind == "file") {
    return open_video_file(config);
  }
  if (config.kind == "v4l2") {
    return open_v4l2_camera(config.live);
  }
  if (config.kind == "libcamera") {
    return open_contained_camera(config);
  }
  throw Error(ErrorKind::Usage,
              "unknown kind of camera \"" + config.kind + "\"; known: file, v4l2, libcamera");
}

}  // namespace facet::camera
