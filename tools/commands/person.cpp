// `facet person FILE`: what is kept of a person.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "maths/statistics.hpp"
#include "options.hpp"
#include "person/person_file.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct Options {
  std::string file;
  std::string output;
  std::string model = default_model_file().string();
};

void run(const Options& options) {
  const person::PersonFile person = person::read_person(options.file);
  if (!options.output.empty()) {
    person::model_of(person, face::FaceModel::load(options.model), options.file).save(options.output);
    return;
  }
  tell("person      {}\n", person.name);
  tell("enrolled    {} by {}\n", person.created_utc, person.software);
  tell("face model  {}, {} vertices\n", person.model_name, person.neutral_mm.cols());
  tell(
      "seen        in {} pictures, {:.0f} degrees at the right to {:.0f} at the left, {:.0f} below to {:.0f} "
      "above\n",
      person.keyframes, -person.span.least_yaw, person.span.largest_yaw, -person.span.least_pitch,
      person.span.largest_pitch);
  tell("camera      focal length {:.0f} px, pictures of {}x{}\n", person.focal_px, person.width_px,
       person.height_px);
  std::vector<float> known;
  std::copy_if(person.sigma_mm.begin(), person.sigma_mm.end(), std::back_inserter(known),
               [](float s) { return std::isfinite(s); });
  if (!known.empty()) {
    tell("uncertain   {:.2f} mm (median standard deviation along the skin's normal)\n",
         maths::median_of(known));
  }
  for (const person::Gate& gate : person.gates) {
    tell("measured    {}: {:.3f} (limit {:.3f})\n", gate.name, gate.value, gate.limit);
  }
}

}  // namespace

void add_person_command(Command program) {
  auto options = std::make_shared<Options>();
  const Command command = program.subcommand(
      "person", "Show what a file that facet enrol wrote holds; to forget the person, remove the file");
  command.option("file", options->file, "NAME.person").required();
  command
      .option(
          "-o,--output", options->output,
          "Instead: write the person as a face model, NAME.facemodel, for commands with --model that work on "
          "takes of that person")
      .ends_in({".facemodel"});
  command.option("--model", options->model, "Face model that the person was enrolled with");
  command.callback([options] { run(*options); });
}

}  // namespace facet::tools
