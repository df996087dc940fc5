#pragma once

#include <nlohmann/json_fwd.hpp>

#include "service/control_protocol.hpp"
#include "studio/studio.hpp"

namespace facet::service {

/// The studio's part of the control protocol: studio.*, pose.* and keys.* (docs/control-protocol.md). Borrows
/// the studio, and the errands for what waits for a disk or takes long to compute.
ControlMethods studio_methods(studio::Studio& studio, Errands& errands);

/// What studio.status answers.
nlohmann::json to_json(const studio::StudioStatus& status);

}  // namespace facet::service
