#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>

#include "avatar/bridge.hpp"
#include "pipeline/status.hpp"
#include "service/web_server.hpp"
#include "stream/server.hpp"
#include "take/recorder.hpp"

namespace facet::service {

/// The parts of what the control method "status" answers (docs/control-protocol.md).
nlohmann::json to_json(const pipeline::PipelineStatus& status);
nlohmann::json to_json(const stream::StreamStatistics& statistics);
nlohmann::json to_json(const WebStatistics& web);
nlohmann::json to_json(const take::RecorderStatus& status);
nlohmann::json to_json(const avatar::BridgeStatus& status);
nlohmann::json to_json(const avatar::ValueTuning& tuning);

/// Memory of this process in use, bytes; 0 where the system does not tell.
std::uint64_t resident_bytes();

}  // namespace facet::service
