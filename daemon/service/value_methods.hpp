#pragma once

#include "avatar/bridge.hpp"
#include "service/control_protocol.hpp"

namespace facet::service {

/// How far avatars follow each of ARKit's values: values.* of the control protocol
/// (docs/control-protocol.md). bridge: outlives them. configured: what values.reset goes back to.
ControlMethods value_methods(avatar::Bridge& bridge, const avatar::ValueTunings& configured);

}  // namespace facet::service
