// `facet person list|show|export|delete`: who is kept, what of them, and how they are forgotten.

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "options.hpp"
#include "person/person_folder.hpp"
#include "persons.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct Options {
  std::string who;
  std::string folder;
  std::string config;
  std::string output;
  std::string model = default_model_file().string();
  bool yes = false;
};

/// --folder, or the configured one; may be empty.
std::filesystem::path folder_of(const Options& options) {
  return options.folder.empty() ? persons_folder(options.config) : std::filesystem::path(options.folder);
}

/// A file that is named needs no configuration.
std::filesystem::path file_of(const Options& options) {
  return person::person_file(
      options.who, person::is_person_path(options.who) ? std::filesystem::path() : folder_of(options));
}

void list(const Options& options) {
  const std::filesystem::path folder = folder_of(options);
  if (folder.empty()) {
    throw Error(ErrorKind::Usage,
                "no folder of persons is configured, so nobody is kept: set folder in [persons] of the "
                "configuration, or give --folder");
  }
  const std::vector<person::StoredPerson> persons = person::stored_persons(folder);
  tell("{} persons in {}\n", persons.size(), folder.string());
  if (persons.empty()) {
    return;
  }
  tell("{:<24} {:<21} {:<24} {}\n", "name", "enrolled (UTC)", "file", "face model");
  for (const person::StoredPerson& stored : persons) {
    if (!stored.fault.empty()) {
      tell("{:<24} bad: {}\n", stored.name(), stored.fault);
      continue;
    }
    tell("{:<24} {:<21} {:<24} {}\n", stored.name(), stored.person.created_utc,
         stored.file.filename().string(), stored.person.model_name);
  }
}

void show(const Options& options) {
  const std::filesystem::path file = file_of(options);
  const person::PersonFile person = person::read_person(file);
  tell("person      {}\n", person.name);
  tell("file        {}\n", file.string());
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

void write_model(const Options& options) {
  const std::filesystem::path file = file_of(options);
  ::umask(S_IRWXG | S_IRWXO);
  person::model_of(person::read_person(file), face::FaceModel::load(options.model), file.string())
      .save(options.output);
  tell("{}\n", options.output);
}

/// The answer to a question on the terminal; where there is none, the person stays.
bool confirmed(const std::filesystem::path& file) {
  if (::isatty(STDIN_FILENO) == 0) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' is not deleted: there is no terminal to ask on; give --yes", file.string()));
  }
  tell("Delete {}? It can't be had back. [y/N] ", file.string());
  std::fflush(stdout);
  const int answer = std::getchar();
  return answer == 'y' || answer == 'Y';
}

void remove(const Options& options) {
  const std::filesystem::path file = file_of(options);
  if (!options.yes && !confirmed(file)) {
    tell("kept\n");
    return;
  }
  person::delete_person(file);
  tell("{} is deleted. Copies elsewhere, face models made of it and takes made with it are not.\n",
       file.string());
}

/// A subcommand that works on one person.
Command add_one(Command parent, const std::string& name, const std::string& help,
                const std::shared_ptr<Options>& options, void (*run)(const Options&)) {
  const Command command = parent.subcommand(name, help);
  command
      .option("person", options->who,
              "Name of a person in the folder, or a file: what has a slash or ends in .person")
      .required();
  command.option("--folder", options->folder, "Folder of the persons, instead of the configured one");
  command.option("--config", options->config, kPersonsConfigHelp).excludes("--folder");
  command.callback([options, run] { run(*options); });
  return command;
}

}  // namespace

void add_person_command(Command program) {
  const Command command =
      program.subcommand("person", "List, show, export and delete the persons that facet enrol wrote");
  command.requires_subcommand();

  const auto listed = std::make_shared<Options>();
  const Command all = command.subcommand("list", "Who is kept in the folder of persons");
  all.option("--folder", listed->folder, "Folder of the persons, instead of the configured one");
  all.option("--config", listed->config, kPersonsConfigHelp).excludes("--folder");
  all.callback([listed] { list(*listed); });

  add_one(command, "show", "What is kept of a person", std::make_shared<Options>(), show);

  const auto exported = std::make_shared<Options>();
  const Command model =
      add_one(command, "export",
              "Write a person as a face model for programs of your own and for [model] path: biometric data, "
              "readable by its owner alone",
              exported, write_model);
  model.option("-o,--output", exported->output, "The file to write, NAME.facemodel")
      .required()
      .ends_in({".facemodel"});
  model.option("--model", exported->model, "Face model that the person was enrolled with").shows_default();

  const auto deleted = std::make_shared<Options>();
  const Command forget =
      add_one(command, "delete", "Forget a person: remove the file, for good", deleted, remove);
  forget.flag("--yes", deleted->yes, "Do not ask");
}

}  // namespace facet::tools
