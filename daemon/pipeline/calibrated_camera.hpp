#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "capture/rig.hpp"
#include "facet/camera.hpp"

namespace facet::pipeline {

/// A camera whose lens is calibrated: hands out its pictures without distortion and knows their intrinsics.
/// Throws as check_size does. Threads as the camera's; allocates a picture a frame where the lens has
/// distortion.
std::unique_ptr<Camera> calibrated(std::unique_ptr<Camera> camera, const capture::RigCamera& known,
                                   const std::filesystem::path& rig_file);

}  // namespace facet::pipeline
