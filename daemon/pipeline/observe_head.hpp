#pragma once

#include <cstdint>
#include <functional>
#include <optional>

#include "person/keyframes.hpp"
#include "pipeline/shading_config.hpp"
#include "pipeline/shading_parts.hpp"

namespace facet::pipeline {

/// A recording's head as its shape is to be learned from it.
struct ObservedHead {
  person::KeyframeCollector keyframes;
  std::uint64_t frames = 0;       ///< of the range
  std::uint64_t mesh_frames = 0;  ///< with a mesh
};

/// Tracks a recording from its first frame to its last and keeps what its head showed.
///
/// parts     of open_shading, without refinement; used up
/// burst     the part of the frames in which lamps fire in turn: it tells of the skin alone
/// go_on     asked before each frame with those done so far; false breaks it off
/// Throws Error: what reading the source throws.
ObservedHead observe_head(ShadingParts& parts, const FrameRange& frames,
                          const std::optional<FrameRange>& burst,
                          const std::function<bool(std::uint64_t done)>& go_on);

}  // namespace facet::pipeline
