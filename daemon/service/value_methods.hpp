#pragma once

#include "avatar/bridge.hpp"
#include "service/control_protocol.hpp"

namespace facet::service {

/// What avatars follow, and how far: values.* and mapping.* of the control protocol
/// (docs/control-protocol.md). bridge, writer: outlive them. config: the bridge's. writer: who writes the
/// mapping file.
ControlMethods value_methods(avatar::Bridge& bridge, const avatar::BridgeConfig& config, Errands& writer);

}  // namespace facet::service
