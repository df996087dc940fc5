#pragma once

#include <memory>
#include <string>
#include <vector>

#include "options.hpp"
#include "simulation/actor.hpp"
#include "simulation/recorded_curves.hpp"

namespace facet::tools {

/// Who the virtual actor is and what it does: options of the commands that render one.
struct ActorChoice {
  std::string model;
  double outside_span_mm = simulation::ActorTraits{}.outside_span_mm;
  double start_s = 0;
  std::string curves;
  std::vector<std::string> left_out;
};

/// Adds --model, --outside-span, --start, --curves and --leave-out.
void add_actor_options(Command command, ActorChoice& choice);

/// The recorded curves that were asked for; null: none. Throws Error(UnreadableInput) naming file, line and
/// column, Error(Usage) for names that are not ARKit's.
std::shared_ptr<const simulation::RecordedCurves> read_curves(const ActorChoice& choice);

}  // namespace facet::tools
