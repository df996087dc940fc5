#pragma once

#include <cstdint>

#include "capture/rig.hpp"

namespace facet::simulation {

/// The rig of the virtual booth, laid out as in [SF04 fig. 1]: on either side of the face a
/// stereo pair of monochrome cameras ("left-l", "left-r", "right-l", "right-r"; sides as the cameras see
/// them), a colour camera ("colour-l", "colour-r") and a projector ("projector-l", "projector-r"). Cameras
/// have 640x480 px, a focal length of about 1600 px and stand 1 m from the face, the two of a pair 280 mm
/// apart; projectors have 1024x768 px and light 520 mm there. Poses and lenses differ a little from the plan,
/// by the seed, and lenses distort.
///
/// The rig's frame: origin in the middle of the resting face, x to the subject's left, y up, z towards the
/// cameras.
///
/// resolution: of the cameras' pictures, along either side; 0.5 gives 320x240 px of the same view. 0.25 to 4.
capture::Rig make_booth_rig(std::uint64_t seed, double resolution = 1);

}  // namespace facet::simulation
