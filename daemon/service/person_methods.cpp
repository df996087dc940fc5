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

/// The shape that the head before the camera showed. subject: whose it is to be.
std::shared_ptr<const person::PersonFile> shown(const pipeline::PipelineStatus& now, double subject) {
  const pipeline::LearningStatus* learning = now.learning.get();
  if (learning == nullptr) {
    throw Error(ErrorKind::Usage,
                "no shape is learned here: that takes one live camera, [model] learn = true and nobody named "
                "as [model] person");
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

}  // namespace

ControlMethods person_methods(std::function<pipeline::PipelineStatus()> now,
                              const std::filesystem::path& folder, Errands& errands, const Log& log) {
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
          {"person.check", {true, {{"name", ControlParam::Type::Text, true}}, check}}};
}

}  // namespace facet::service
