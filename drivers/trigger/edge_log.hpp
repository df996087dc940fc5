#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "facet/trigger.hpp"

namespace facet::trigger {

/// What happened on a trigger's lines, for people and pictures.
struct EdgeLog {
  std::vector<TriggerLine> lines;  ///< name, role and safe_active alone
  std::vector<TriggerEvent> events;
};

/// Text, a line each: "facet-edges 1"; "line NAME camera|projector REST" for every line; then events as
/// "edge|seen|missing|dropped|fired LINE ACTIVE SLOT COUNT PLANNED_NS ACTUAL_NS CALL_NS", LINE counted from
/// 0.
std::string to_text(const EdgeLog& log);
/// An event's line alone, for whoever writes a log as it happens: it begins with the text of one without
/// events.
std::string to_text(const TriggerEvent& event);

/// An edge log holds no more.
inline constexpr std::size_t kMostLoggedEvents = 1'000'000;

/// Throws Error(UnreadableInput) with the line's number; `file` is for the message. At most
/// kMostLoggedEvents.
EdgeLog parse_edge_log(std::string_view text, const std::string& file);

}  // namespace facet::trigger
