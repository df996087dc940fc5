#include "camera/factory.hpp"

#include "camera/v4l2_camera.hpp"
#include "camera/video_file.hpp"
#include "facet/error.hpp"

namespace facet::camera {

std::unique_ptr<Camera> open_camera(const CameraConfig& config) {
  if (config.kind == "file") {
    return open_video_file(config);
  }
  if (config.kind == "v4l2") {
    return open_v4l2_camera(config.v4l2);
  }
  throw Error(ErrorKind::Usage, "unknown kind of camera \"" + config.kind + "\"; known: file, v4l2");
}

}  // namespace facet::camera
