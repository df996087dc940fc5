#pragma once

#include <memory>

#include "camera/factory.hpp"

namespace facet::camera {

/// A recorded video or picture as a camera: Motion JPEG in AVI is read by ourselves, everything else by
/// FFmpeg, whose libraries are opened for it. Rotation metadata and non-square pixels are applied, colours
/// are converted by the stream's own matrix and range to sRGB-coded RGB. A picture-size change inside the
/// file is scaled to the first size. A damaged packet costs the frames in it (marked corrupt where the
/// decoder shows them); a truncated file ends early with the reason in last_error(). Throws
/// Error(UnreadableInput) naming the file, and the library that is missing.
std::unique_ptr<Camera> open_video_file(const CameraConfig& config);

/// Throws Error(Unavailable) naming the library of FFmpeg and its package that is not there. Without them
/// only Motion JPEG in AVI is read.
void require_ffmpeg();

extern const CameraKind kVideoFile;

}  // namespace facet::camera
