#pragma once

#include <filesystem>
#include <memory>

#include "facet/camera.hpp"

namespace facet::camera {

/// Which source, and how it behaves. Kinds: "file" (any video or picture that FFmpeg reads).
struct CameraConfig {
  std::string kind = "file";
  std::filesystem::path path{};  ///< file: the video
  bool paced = false;  ///< file: deliver at the recorded rate and skip what the reader is too slow for, like
                       ///< a live camera
  bool loop = false;   ///< file: start over at the end; sequence and times go on
};

/// Opens a source; throws Error(Usage) for an unknown kind, Error(UnreadableInput) naming the file or device
/// and what is wrong with it. A new kind of camera is one more file in this folder and one more line in this
/// function.
std::unique_ptr<Camera> open_camera(const CameraConfig& config);

}  // namespace facet::camera
