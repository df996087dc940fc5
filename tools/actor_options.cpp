#include "actor_options.hpp"

#include "facet/assets.hpp"

namespace facet::tools {

void add_actor_options(Command command, ActorChoice& choice) {
  choice.model = default_model_file().string();
  command
      .option(
          "--model", choice.model,
          "Face model file that the actor is made of; one that the tracker does not use makes it a stranger")
      .shows_default();
  command
      .option(
          "--outside-span", choice.outside_span_mm,
          "How far the actor's face lies outside of what the model can make, mm rms; 0: one of the model's "
          "own faces")
      .shows_default()
      .range(0.0, 5.0);
  command
      .option("--start", choice.start_s,
              "Second of the performance or of the recorded curves to begin with: the actor is met in the "
              "middle of an expression")
      .shows_default()
      .range(0.0, 36'000.0);
  command.option("--curves", choice.curves,
                 "Expressions as Live Link Face recorded them (CSV) instead of acted ones; the head's turns, "
                 "too, where they were recorded");
  command
      .option(
          "--leave-out", choice.left_out,
          "Of the curves: ARKit's names of values to set to 0, as tongueOut where the model has no tongue")
      .delimiter(',')
      .needs("--curves");
}

std::shared_ptr<const simulation::RecordedCurves> read_curves(const ActorChoice& choice) {
  if (choice.curves.empty()) {
    return nullptr;
  }
  auto curves = std::make_shared<simulation::RecordedCurves>(simulation::RecordedCurves::read(choice.curves));
  for (const std::string& name : choice.left_out) {
    curves->leave_out(name);
  }
  return curves;
}

}  // namespace facet::tools
