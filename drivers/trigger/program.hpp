#pragma once

#include "facet/trigger.hpp"

namespace facet::trigger {

/// Throws Error(Usage) where the program can't be run as it is, saying which number must change and how.
void check(const TriggerProgram& program);

/// The lines of one role.
LineMask lines_of(const TriggerProgram& program, LineRole role);
/// The lines that are active at rest.
LineMask safe_lines(const TriggerProgram& program);

}  // namespace facet::trigger
