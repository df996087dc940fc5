#pragma once

#include <memory>

#include "facet/camera.hpp"
#include "simulation/studio.hpp"

namespace facet::simulation {

/// A camera in front of the virtual actor: a recorded source of config.frame_count frames, each rendered when
/// it is asked for. `next` takes as long as a frame takes to render (about a second at 1280x720), whatever
/// its timeout. Frames carry the time at which they were due at config.rate_hz, or were done where that is
/// later. Life and threads as in Camera.
std::unique_ptr<Camera> make_simulated_camera(const face::FaceModel& model, const StudioConfig& config);

}  // namespace facet::simulation
