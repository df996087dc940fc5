#pragma once

#include "avatar/value_mapping.hpp"

namespace facet::avatar {

/// VRM 0.x's presets (https://github.com/vrm-c/vrm-specification, 0.0, "Blend Shape Presets"), made of
/// ARKit's values by formulas that docs/bridges.md lists. Mouth: A, I, U, E and O together are 1 at most;
/// feelings: Joy, Angry, Sorrow and Fun the same. Lids: Blink is what both eyes do, Blink_L and Blink_R what
/// one does beyond it, so that an avatar with all three closes each eye once.
MappedValues vrm_presets();

/// VRCFaceTracking's Unified Expressions ("v2" parameters, without "v2/"), as far as ARKit's values tell
/// them, each 0 to 1, those with two sides -1 to 1 (docs/bridges.md lists them).
MappedValues unified_expressions();

/// VTube Studio's own tracking parameters, as far as ARKit's values tell them; those of the head are not
/// among them (docs/bridges.md lists them).
MappedValues vts_values();

}  // namespace facet::avatar
