#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "capture/rig.hpp"
#include "facet/camera.hpp"

namespace facet::pipeline {

/// The pinhole of a lens, its distortion left out.
CameraIntrinsics pinhole_of(const capture::Lens& lens);

/// The camera of that name. Throws Error(Usage), which names the file, the cameras that there are and what to
/// do (`advice`), where there is none.
const capture::RigCamera& camera_named(const capture::Rig& rig, const std::filesystem::path& rig_file,
                                       const std::string& name, const std::string& advice);

/// Throws Error(Usage) where a camera's pictures have another size than was calibrated. rig_file: for the
/// message.
void check_size(const CameraInfo& camera, const capture::RigCamera& known,
                const std::filesystem::path& rig_file);

/// A camera whose lens is calibrated: hands out its pictures without distortion and knows their intrinsics.
/// Throws as check_size does. Threads as the camera's; allocates a picture a frame where the lens has
/// distortion.
std::unique_ptr<Camera> calibrated(std::unique_ptr<Camera> camera, const capture::RigCamera& known,
                                   const std::filesystem::path& rig_file);

}  // namespace facet::pipeline
