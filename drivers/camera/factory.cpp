#include "camera/factory.hpp"

#include "camera/video_file.hpp"
#include "facet/error.hpp"

namespace facet::camera {

std::unique_ptr<Camera> open_camera(const CameraConfig& config) {
  if (config.kind == "file") {
    return open_video_file(config);
  }
  throw Error(ErrorKind::Usage, "unknown kind of camera \"" + config.kind + "\"; known: file");
}

}  // namespace facet::camera
