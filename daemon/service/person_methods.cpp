#include "service/person_methods.hpp"

#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "person/person_folder.hpp"
#include "service/service.hpp"

namespace facet::service {

using nlohmann::json;

namespace {

constexpr double kWhoeverIsThere = -1;
constexpr const char* kNothingIsLearned =
    "no shape is learned here: that takes one live camera, [model] learn = true and nobody named as [model] "
    "person";

/// The shape that the head before the camera showed. subject: whose it is to be.
std::shared_ptr<const person::PersonFile> shown(const pipeline::PipelineStatus& now, double subject) {
  const pipeline::LearningStatus* learning = now.learning.get();
  if (learning == nullptr) {
    throw Error(ErrorKind::Usage, kNothingIsLearned);
  }
  if (learning->person == nullptr) {
    throw Error(ErrorKind::Usage,
                fmt::format("the head has not shown its shape yet: turn it to both sides by {:.0f} degrees "
                            "and more, the face at rest{}{}",
                            learning->needed_deg, learning->note.empty() ? "" : "; ", learning->note));
  }
  if (now.tracking != mesh::TrackingState::Tracking ||
      (subject != kWhoeverIsThere && subject != learning->subject)) {
    throw Error(ErrorKind::NoFace,
                "whose shape was learned is not before the camera now: nobody is kept who is not there");
  }
  return learning->person;
}

/// Throws where no lamps could fire for somebody.
json burst_to_come(const pipeline::PipelineStatus& now) {
  const pipeline::LearningStatus* learning = now.learning.get();
  if (learning == nullptr) {
    throw Error(ErrorKind::Usage, kNothingIsLearned);
  }
  if (learning->lamps == 0) {
    throw Error(ErrorKind::Usage,
                "no lamps are configured: name their lines in [lamps]; of lamps that are switched by hand "
                "record a video, and give it to 'facet enrol VIDEO --burst A:B'");
  }
  if (learning->state != pipeline::LearningStatus::State::Looking) {
    throw Error(ErrorKind::Usage,
                fmt::format("the face before the camera is {} already: 'facet reset-identity' forgets that",
                            to_string(learning->state)));
  }
  if (now.tracking != mesh::TrackingState::Tracking) {
    throw Error(ErrorKind::NoFace, "no face is before the camera now: the lamps stay off");
  }
  return {{"lamps", learning->lamps}, {"seconds", learning->burst_s}};
}

}  // namespace

ControlMethods person_methods(std::function<pipeline::PipelineStatus()> now, std::function<void()> burst,
                              const std::filesystem::path& folder, Errands& errands, const Log& log) {
  const auto fire = [now, burst = std::move(burst), &log](const json&) {
    json answer = burst_to_come(now());
    burst();
    log.info("the lamps fire, as asked over the control socket");
    return answer;
  };
  const auto keep = [now = std::move(now), folder, &errands, &log](const json& params) {
    const std::string name = params.at("name");
    person::check_person_name(name);
    const double subject = params.value("subject", kWhoeverIsThere);
    return ControlAnswer(errands, [name, learned = shown(now(), subject), folder, &log] {
      const std::filesystem::path file = person::new_person_file(folder, name);
      person::PersonFile person = *learned;
      person.name = name;
      person.software = software_name();
      person::write_person(person, file);
      log.info(
          fmt::format("person '{}' is kept in {}, as asked over the control socket", name, file.string()));
      return to_text({{"file", file.string()}});
    });
  };
  // Before somebody turns the head for it.
  const auto check = [folder, &errands](const json& params) {
    const std::string name = params.at("name");
    person::check_person_name(name);
    return ControlAnswer(errands, [name, folder] {
      return to_text({{"file", person::new_person_file(folder, name).string()}});
    });
  };
  return {{"person.keep",
           {true, {{"name", ControlParam::Type::Text, true}, {"subject", ControlParam::Type::Number}}, keep}},
          {"person.burst", {true, {}, fire}},
          {"person.check", {true, {{"name", ControlParam::Type::Text, true}}, check}}};
}

}  // namespace facet::service
