#pragma once

#include <memory>

#include "camera/factory.hpp"

namespace facet::camera {

/// A recorded video or picture as a camera, read with FFmpeg. Rotation metadata and non-square pixels are
/// applied, colours are converted by the stream's own matrix and range to sRGB-coded RGB. A picture-size
/// change inside the file is scaled to the first size. A damaged packet costs the frames in it (marked
/// corrupt where the decoder shows them); a truncated file ends early with the reason in last_error(). Throws
/// Error(UnreadableInput).
std::unique_ptr<Camera> open_video_file(const CameraConfig& config);

extern const CameraKind kVideoFile;

}  // namespace facet::camera
