#pragma once

#include "render/renderer.hpp"
#include "trigger/edge_log.hpp"

namespace facet::report {

/// The timing diagram of a log's first `slot_count` slots: a row per line with its actual level over its
/// planned edges, what a read-back line saw (dots), dropped slots, and how late the line's edges were.
render::Picture draw_trigger_diagram(const trigger::EdgeLog& log, std::uint64_t slot_count);

}  // namespace facet::report
