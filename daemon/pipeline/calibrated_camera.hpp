#pragma once

#include <memory>
#include <string>

#include "capture/rig.hpp"
#include "facet/camera.hpp"

namespace facet::pipeline {

/// The pinhole of a lens, its distortion left out.
CameraIntrinsics pinhole_of(const capture::Lens& lens);

/// A camera whose lens is calibrated: hands out its pictures without distortion and knows their intrinsics.
/// Throws Error(Usage) where the pictures have another size than was calibrated. `name`: of the rig's camera,
/// for messages. Threads as the camera's; allocates a picture a frame where the lens has distortion.
std::unique_ptr<Camera> calibrated(std::unique_ptr<Camera> camera, const std::string& name,
                                   const capture::Lens& lens);

}  // namespace facet::pipeline
