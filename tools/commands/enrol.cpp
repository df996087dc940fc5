// `facet enrol VIDEO --name NAME`: the shape of a face from its head's turning, kept.

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "person/enrolment.hpp"
#include "person/person_folder.hpp"
#include "persons.hpp"
#include "pipeline/observe_head.hpp"
#include "progress.hpp"
#include "service/config.hpp"
#include "stop_signals.hpp"
#include "take_frames.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct Options {
  std::string video;
  std::string person;
  std::string name;
  std::string config;
  std::string frames;
};

std::string now_utc() {
  const auto seconds = std::chrono::time_point_cast<std::chrono::seconds>(Clock::utc());
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(seconds));
}

pipeline::ObservedHead look(const pipeline::ShadingConfig& config, const std::string& video,
                            pipeline::ShadingParts& parts, const StopSignals& signals) {
  const std::optional<std::uint64_t> count = parts.pictures->cameras().front().info.frame_count;
  Progress progress("Looking", count.value_or(0));
  pipeline::ObservedHead head = pipeline::observe_head(parts, config.frames, [&](std::uint64_t done) {
    progress.set(done);
    return signals.pending() == 0;
  });
  progress.finish();
  if (head.mesh_frames == 0) {
    throw Error(
        ErrorKind::NoFace,
        fmt::format(
            "no face could be followed in the {} frames of '{}': give a video in which one face looks "
            "at the camera, upright and lit, and then turns",
            head.frames, video));
  }
  return head;
}

person::LearnedShape learn(const face::FaceModel& model, const person::Observed& observed,
                           const person::EnrolmentOptions& options, const StopSignals& signals) {
  std::unique_ptr<Progress> progress;
  person::LearnedShape learned = person::learn_shape(model, observed, options, [&](int done, int total) {
    if (!progress) {
      progress = std::make_unique<Progress>("Learning", static_cast<std::uint64_t>(total), "steps");
    }
    progress->set(static_cast<std::uint64_t>(done));
    return signals.pending() == 0;
  });
  if (signals.pending() != 0) {
    signals.die_of(signals.pending());
  }
  return learned;
}

/// Where the person goes, and what for a name.
struct Place {
  std::filesystem::path file;
  std::string name;
};

/// Refuses before anything is learned what could not be written after it.
Place place_of(const Options& options) {
  if (options.person.empty() && options.name.empty()) {
    throw Error(ErrorKind::Usage,
                "give the person's --name, to be kept in the folder of persons, or a file with -o");
  }
  if (options.person.empty()) {
    return {person::new_person_file(persons_folder(options.config), options.name), options.name};
  }
  Place place{options.person, options.name};
  if (place.name.empty()) {
    place.name = place.file.stem().string();
  }
  person::check_person_name(place.name);
  if (std::filesystem::exists(place.file)) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' exists already: give another name, or remove it", options.person));
  }
  return place;
}

void run(const Options& options) {
  service::Config config =
      options.config.empty() ? service::default_config() : service::load_config(options.config);
  pipeline::ShadingConfig& shading = config.pipeline;
  shading.source = {};
  shading.source.path = options.video;
  shading.person.clear();  // whoever the configuration says stands there is not who is learned now
  shading.gpu_device = pipeline::kNoDevice;
  shading.learn_person = false;
  if (!options.frames.empty()) {
    shading.frames = pipeline::parse_frame_range(options.frames);
  }
  const Place place = place_of(options);
  const StopSignals signals;
  pipeline::ShadingParts parts = pipeline::open_shading(shading);
  const pipeline::ObservedHead head = look(shading, options.video, parts, signals);
  if (signals.pending() != 0) {
    signals.die_of(signals.pending());
  }
  person::EnrolmentOptions how;
  how.focal_is_known = shading.tracker.intrinsics.has_value();
  const std::optional<person::Observed> observed = head.keyframes.observed(how.keyframes);
  if (!observed) {
    throw Error(
        ErrorKind::NoFace,
        fmt::format(
            "'{}' is too short: {} frames of one face that is known are needed, it has {} with a mesh",
            options.video, how.keyframes, head.mesh_frames));
  }
  const person::LearnedShape learned = learn(*parts.model, *observed, how, signals);
  const person::KeyframeCollector::Span span = head.keyframes.span();
  tell(
      "seen from {:.0f} degrees at its right to {:.0f} at its left, {:.0f} below to {:.0f} above; {} "
      "pictures used\n",
      -span.least_yaw, span.largest_yaw, -span.least_pitch, span.largest_pitch, learned.keyframes.size());
  for (const person::Gate& gate : learned.gates) {
    tell("  {:<34} {:8.3f}   (limit {:.3f}){}\n", gate.name, gate.value, gate.limit,
         gate.passed ? "" : "   refused");
  }
  if (!learned.accepted) {
    throw Error(ErrorKind::NoFace,
                fmt::format("'{}': no person was learned: {}", options.video, learned.refused));
  }
  person::PersonFile person;
  person.name = place.name;
  person.created_utc = now_utc();
  person.software = "facet enrol " FACET_VERSION;
  person.model_name = parts.model->name;
  person.model_checksum = person::model_checksum(*parts.model);
  person.keyframes = static_cast<int>(learned.keyframes.size());
  person.span = span;
  person.focal_px = learned.focal_px;
  person.width_px = observed->camera.width_px;
  person.height_px = observed->camera.height_px;
  person.gates = learned.gates;
  person.identity = learned.identity;
  person.neutral_mm = learned.neutral_mm.cast<float>();
  const Eigen::VectorXf sigma = learned.sigma_mm.cast<float>();
  person.sigma_mm.assign(sigma.begin(), sigma.end());
  person::write_person(person, place.file);
  tell("{}: focal length {:.0f} px of {}x{} (was taken for {:.0f}); follow this face with --person {}\n",
       place.file.string(), learned.focal_px, person.width_px, person.height_px,
       static_cast<double>(observed->camera.fx), options.person.empty() ? place.name : options.person);
}

}  // namespace

void add_enrol_command(Command program) {
  auto options = std::make_shared<Options>();
  const Command command = program.subcommand(
      "enrol", "Learn the shape of a face from a video in which the head turns, and keep it for later takes");
  command
      .option("video", options->video,
              "A video of five to ten seconds: the face at rest looks at the camera, then turns left, right, "
              "up and "
              "down, 20 degrees and more to both sides")
      .required();
  command
      .option("-o,--output", options->person,
              "The file to write, NAME.person; must not exist yet. It is biometric data: whoever has it can "
              "recognise the face. Default: NAME.person of --name, in the folder of persons")
      .ends_in({".person"});
  command.option("--name", options->name, "The person's name; default: the file's");
  command.option("--config", options->config,
                 "Configuration file; of [source], only frames and intrinsics count. Its [persons] folder is "
                 "where the person goes, without it that of the installed configuration");
  command.option("--frames", options->frames, kFramesHelp);
  command.callback([options] { run(*options); });
}

}  // namespace facet::tools
