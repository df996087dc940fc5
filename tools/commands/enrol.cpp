// `facet enrol VIDEO --name NAME`, `facet enrol VIDEO --improve NAME`, `facet enrol --live --name NAME`: the
// shape of a face from its head's turning, kept.

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "daemon_options.hpp"
#include "face/person_model.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "person/enrolment.hpp"
#include "person/improved_person.hpp"
#include "person/person_folder.hpp"
#include "persons.hpp"
#include "pipeline/observe_head.hpp"
#include "pipeline/refined_relief.hpp"
#include "progress.hpp"
#include "service/config.hpp"
#include "stop_signals.hpp"
#include "take_frames.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

struct Options {
  std::string video;
  std::string person;
  std::string name;
  std::string config;
  std::string frames;
  std::string burst;
  std::string socket;
  std::string improve;
  bool live = false;
  bool lamps = false;  ///< with live
};

pipeline::ObservedHead look(const pipeline::ShadingConfig& config, const Options& options,
                            const std::optional<pipeline::FrameRange>& burst, pipeline::ShadingParts& parts,
                            const StopSignals& signals) {
  const std::optional<std::uint64_t> count = parts.pictures->cameras().front().info.frame_count;
  Progress progress("Looking", count.value_or(0));
  pipeline::ObservedHead head = pipeline::observe_head(parts, config.frames, burst, [&](std::uint64_t done) {
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
            head.frames, options.video));
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

/// Refines the relief that was found; one of a burst is nearer as it is. Returns why it was not, for people.
std::string refine(const face::FaceModel& model, const person::Observed& observed,
                   const pipeline::ShadingConfig& shading, const StopSignals& signals,
                   person::LearnedShape& learned) {
  if (!learned.accepted || !learned.skin.believed || !observed.burst.empty() ||
      shading.gpu_device == pipeline::kNoDevice) {
    return {};
  }
  face::FaceModel own = face::person_model(model, learned.identity, learned.neutral_mm, "enrolled");
  own.skin = learned.skin.chart;
  track::TrackerConfig tracker = shading.tracker;
  if (!tracker.intrinsics) {
    tracker.intrinsics = observed.camera;
    tracker.intrinsics->fx = tracker.intrinsics->fy = static_cast<float>(learned.focal_px);
  }
  constexpr std::uint64_t kTimes = 3;  // a picture is tracked twice and refined once
  const std::uint64_t total = kTimes * observed.keyframes.size();
  Progress progress("Refining", total, "steps");
  std::uint64_t done = 0;
  std::string missed = pipeline::refine_relief(
      own, observed, tracker, {shading.hierarchy, refine::refiner_opener({.device = shading.gpu_device}, {})},
      [&] {
        progress.set(std::min(done++, total));
        return signals.pending() == 0;
      });
  progress.finish();
  if (signals.pending() != 0) {
    signals.die_of(signals.pending());
  }
  learned.skin.chart = std::move(own.skin);
  return missed;
}

/// Where the person goes, what for a name, and who it is.
struct Place {
  std::filesystem::path file;
  std::string name;
  std::optional<person::PersonFile> before = std::nullopt;  ///< who is enrolled once more
  bool replaces = false;                                    ///< the file is there, and theirs
};

/// -o, and --name or what the file is called.
Place new_file(const Options& options) {
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

/// Throws where who is known can't be put back where they are.
void check_replaceable(const std::filesystem::path& file) {
  struct stat found {};
  if (::lstat(file.c_str(), &found) != 0 || !S_ISREG(found.st_mode)) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is a link: name the person's file itself", file.string()));
  }
  if (found.st_uid != ::geteuid()) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' belongs to another user, who could not read it any more: "
                                              "run this command as that user, or write elsewhere with -o",
                                              file.string()));
  }
  const std::filesystem::path folder = std::filesystem::absolute(file).parent_path();
  if (::faccessat(AT_FDCWD, folder.c_str(), W_OK | X_OK, AT_EACCESS) != 0) {
    throw Error(ErrorKind::Storage, fmt::format("folder '{}' can't be written to: {}", folder.string(),
                                                std::system_category().message(errno)));
  }
}

Place improved_place(const Options& options) {
  if (options.person.empty() && !options.name.empty()) {
    throw Error(ErrorKind::Usage, "--improve keeps the person's name: give --name with -o, or leave it out");
  }
  const bool by_file = person::is_person_path(options.improve);
  const std::filesystem::path known = person::person_file(
      options.improve, by_file ? std::filesystem::path() : persons_folder(options.config));
  person::PersonFile before = person::read_person(known);
  if (before.sigma_mm.empty()) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' does not say how certain its shape is: it can't be weighed "
                            "against another one; enrol the person anew",
                            known.string()));
  }
  Place place;
  if (options.person.empty()) {
    check_replaceable(known);
    place = {known, before.name};
    place.replaces = true;
  } else {
    place = new_file(options);
  }
  place.before = std::move(before);
  return place;
}

/// Refuses before anything is learned what could not be written after it.
Place place_of(const Options& options) {
  if (!options.improve.empty()) {
    return improved_place(options);
  }
  if (options.person.empty() && options.name.empty()) {
    throw Error(ErrorKind::Usage,
                "give the person's --name, to be kept in the folder of persons, or a file with -o");
  }
  return options.person.empty()
             ? Place{person::new_person_file(persons_folder(options.config), options.name), options.name}
             : new_file(options);
}

/// The person before, made better by what was learned now.
person::PersonFile improve(const face::FaceModel& model, const person::PersonFile& before,
                           const person::PersonFile& now, const Options& options) {
  person::ImprovedPerson both = person::improved(model, before, now);
  tell("  {:<34} {:8.3f}   (limit {:.3f}){}\n", "distance from who is known, sigma", both.disagreement,
       person::kSameHead, both.same_head ? "" : "   refused");
  if (!both.same_head) {
    throw Error(
        ErrorKind::NoFace,
        fmt::format("'{}': this is not the head of '{}', or one of the two turns was bad: nothing was "
                    "changed; give the right person, film the turn again, or enrol anew with --name",
                    options.video, options.improve));
  }
  return std::move(both.person);
}

/// Writes who was learned, and says where.
void keep(const Place& place, person::PersonFile person, float guessed_focal_px, const Options& options) {
  person.name = place.name;
  person.software = "facet enrol " FACET_VERSION;
  place.replaces ? person::replace_person(person, *place.before, place.file)
                 : person::write_person(person, place.file);
  const bool by_file = !options.person.empty() || person::is_person_path(options.improve);
  tell("{}: focal length {:.0f} px of {}x{} (was taken for {:.0f}); follow this face with --person {}\n",
       place.file.string(), person.focal_px, person.width_px, person.height_px, guessed_focal_px,
       by_file ? place.file.string() : place.name);
}

/// Throws where the frames that are said to be a burst show no lamps, or are all that there is.
void check_burst(const Options& options, const pipeline::ObservedHead& head,
                 const std::optional<person::Observed>& observed) {
  if (options.burst.empty()) {
    return;
  }
  if (head.keyframes.size() == 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("--burst {} leaves no frame in which the head turns", options.burst));
  }
  if (observed && observed->light_count() < 2) {
    throw Error(
        ErrorKind::NoFace,
        fmt::format("--burst {}: the face is not seen under two lights there, each for three frames, the "
                    "head still and the face at rest",
                    options.burst));
  }
}

void run(const Options& options) {
  if (!options.socket.empty()) {
    throw Error(ErrorKind::Usage, "--socket goes with --live: a video needs no daemon");
  }
  if (options.lamps) {
    throw Error(ErrorKind::Usage, "--lamps goes with --live: say with --burst where in the video lamps fire");
  }
  if (options.video.empty()) {
    throw Error(ErrorKind::Usage, "give a video of the head, or --live for the running daemon's camera");
  }
  service::Config config =
      options.config.empty() ? service::default_config() : service::load_config(options.config);
  pipeline::ShadingConfig& shading = config.pipeline;
  shading.source = {};
  shading.source.path = options.video;
  shading.person.clear();  // whoever the configuration says stands there is not who is learned now
  shading.learn_live = false;
  if (!options.frames.empty()) {
    shading.frames = pipeline::parse_frame_range(options.frames);
  }
  std::optional<pipeline::FrameRange> burst;
  if (!options.burst.empty()) {
    burst = pipeline::parse_frame_range(options.burst);
  }
  const Place place = place_of(options);
  const StopSignals signals;
  pipeline::ShadingConfig coarse = shading;
  coarse.gpu_device = pipeline::kNoDevice;
  pipeline::ShadingParts parts = pipeline::open_shading(coarse);
  if (place.before) {
    person::check_model(*place.before, *parts.model, options.improve);
  }
  const pipeline::ObservedHead head = look(shading, options, burst, parts, signals);
  if (signals.pending() != 0) {
    signals.die_of(signals.pending());
  }
  person::EnrolmentOptions how;
  how.focal_is_known = shading.tracker.intrinsics.has_value();
  const std::optional<person::Observed> observed = head.keyframes.observed(how.keyframes, how.lit);
  check_burst(options, head, observed);
  if (!observed) {
    throw Error(
        ErrorKind::NoFace,
        fmt::format(
            "'{}' is too short: {} frames of one face that is known are needed, it has {} with a mesh",
            options.video, how.keyframes, head.mesh_frames));
  }
  person::LearnedShape learned = learn(*parts.model, *observed, how, signals);
  const std::string not_refined = refine(*parts.model, *observed, shading, signals, learned);
  const person::OrientationSpan& span = observed->span;
  tell(
      "seen from {:.0f} degrees at its right to {:.0f} at its left, {:.0f} below to {:.0f} above; {} "
      "pictures used{}\n",
      -span.least_yaw, span.largest_yaw, -span.least_pitch, span.largest_pitch, learned.keyframes.size(),
      observed->burst.empty() ? ""
                              : fmt::format(", and {} of the burst under {} lights", observed->burst.size(),
                                            observed->light_count()));
  for (const person::Gate& gate : learned.gates) {
    tell("  {:<34} {:8.3f}   (limit {:.3f}){}\n", gate.name, gate.value, gate.limit,
         gate.passed ? "" : "   refused");
  }
  if (!learned.skin_note.empty()) {
    tell("{}\n", learned.skin_note);
  } else if (learned.skin.believed) {
    tell(
        "the skin's relief: {:.2f} of what one half of the pictures shows is in the other (limit 0.50); "
        "light and "
        "colour leave {:.1f} % of the brightness\n",
        learned.skin.agreement, 100 * learned.skin.residual);
    if (!not_refined.empty()) {
      tell("{}\n", not_refined);
    }
    if (learned.skin.lamps > 0) {
      tell("the burst: {} lamps, told from the room's light\n", learned.skin.lamps);
    } else if (!observed->burst.empty()) {
      tell(
          "the burst: no lamps were told from the room's light, so it tells less: two of them must stand 40 "
          "degrees apart as the face sees them, and three pictures show none\n");
    }
  }
  if (!learned.accepted) {
    throw Error(ErrorKind::NoFace,
                fmt::format("'{}': no person was learned: {}", options.video, learned.refused));
  }
  person::PersonFile person = person::person_of(*parts.model, *observed, learned);
  if (place.before) {
    person = improve(*parts.model, *place.before, person, options);
  }
  keep(place, std::move(person), observed->camera.fx, options);
}

/// What the person before the camera is to do, or waits for.
std::string next_step(const json& learning) {
  const double needed = learning["needed_deg"];
  const double left = learning["turned_left_deg"];
  const double right = learning["turned_right_deg"];
  if (learning["state"] == "solving") {
    const std::string note = learning["note"];
    return note.empty() ? "solving: half a minute and more; frames come first" : note;
  }
  if (left < needed || right < needed) {
    return fmt::format(
        "face at rest, turn the head {}: {:.0f} degrees to its left, {:.0f} to its right of {:.0f}",
        left < needed && right < needed ? "slowly to both sides"
        : left < needed                 ? "to its left"
                                        : "to its right",
        left, right, needed);
  }
  const std::string note = learning["note"];
  return note.empty() ? "enough was seen: hold still for two seconds"
                      : note + "; turn once more, further, the face at rest";
}

/// Has the daemon's lamps fire in turn once a face is there, and waits until they did.
void fire_lamps(const DaemonOptions& daemon, const StopSignals& signals) {
  const auto wait = [&](std::chrono::milliseconds time) {
    std::this_thread::sleep_for(time);
    if (signals.pending() != 0) {
      signals.die_of(signals.pending());
    }
    return call_daemon(daemon, "status");
  };
  const auto say = [](const std::string& text) {
    tell("{}\n", text);
    std::fflush(stdout);
  };
  json status = call_daemon(daemon, "status");
  if (status["learning"].is_object() && status["learning"]["lamps"] > 0 && status["tracking"] != "tracking") {
    say("look at the camera: no face is followed yet");
    while (status["tracking"] != "tracking") {
      status = wait(std::chrono::milliseconds(250));
    }
  }
  const int before = status["learning"].is_object() ? status["learning"].value("bursts", 0) : 0;
  const json subject = status["learning"].is_object() ? status["learning"]["subject"] : json();
  if (status["learning"].is_object() && status["learning"]["lamps"] > 0) {
    say("look at the camera, the face at rest, and hold still: in two seconds the lamps fire one by one");
    wait(std::chrono::seconds(2));
  }
  const json burst = call_daemon(daemon, "person.burst");
  const double patience_s = burst["seconds"].get<double>() + 10;
  const Clock::time_point until = Clock::now() + std::chrono::milliseconds(std::llround(1000 * patience_s));
  json learning;
  do {
    learning = wait(std::chrono::milliseconds(100))["learning"];
    const bool is_gone =
        !learning.is_object() || learning["subject"] != subject || learning["bursts"] < before;
    if (is_gone || Clock::now() > until) {
      throw Error(ErrorKind::NoFace, "the face left the camera while the lamps fired: try again");
    }
  } while (learning["bursts"] == before);
  if (learning["lights"] < 2) {
    throw Error(ErrorKind::NoFace,
                fmt::format("{}: nearer or brighter lamps, or less light in the room; then try again",
                            learning["note"].get<std::string>()));
  }
  say(fmt::format("the face was seen under {} lights", learning["lights"].get<int>()));
}

/// Has the daemon keep what the head before its camera shows.
void run_live(const Options& options) {
  if (!options.video.empty() || !options.person.empty() || !options.frames.empty() ||
      !options.burst.empty() || !options.improve.empty()) {
    throw Error(ErrorKind::Usage,
                "--live takes no video, no --frames, no --burst, no --improve and no -o: the daemon's camera "
                "sees the head, and its [persons] folder keeps who is named with --name");
  }
  if (options.name.empty()) {
    throw Error(ErrorKind::Usage, "give the person's --name, to be kept in the daemon's folder of persons");
  }
  person::check_person_name(options.name);
  const DaemonOptions daemon{options.socket, options.config};
  call_daemon(daemon, "person.check", {{"name", options.name}});  // before somebody turns the head for it
  const StopSignals signals;
  if (options.lamps) {
    fire_lamps(daemon, signals);
  }
  std::string said;
  json learning = call_daemon(daemon, "status")["learning"];
  while (!learning.is_null() && learning["state"] != "learned") {
    if (const std::string step = next_step(learning); step != said) {
      tell("{}\n", step);
      std::fflush(stdout);
      said = step;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(250));
    if (signals.pending() != 0) {
      signals.die_of(signals.pending());
    }
    learning = call_daemon(daemon, "status")["learning"];
  }
  if (!learning.is_null() && said.empty()) {
    tell("who is before the camera was learned already ('facet reset-identity' forgets that)\n");
  }
  json params = {{"name", options.name}};
  if (!learning.is_null()) {
    params["subject"] = learning["subject"];
  }
  const json kept = call_daemon(daemon, "person.keep", params);
  tell("{}: the daemon follows this face with person = \"{}\" in [model]\n", kept["file"].get<std::string>(),
       options.name);
}

}  // namespace

void add_enrol_command(Command program) {
  auto options = std::make_shared<Options>();
  const Command command = program.subcommand(
      "enrol", "Learn the shape of a face from a video in which the head turns, and keep it for later takes");
  command.option("video", options->video,
                 "A video of five to ten seconds: the face at rest looks at the camera, then turns left, "
                 "right, up and down, 20 degrees and more to both sides");
  command.flag(
      "--lamps", options->lamps,
      "With --live: first the daemon's lamps ([lamps]) fire in turn for some seconds, and the skin's "
      "relief is found from how the face looks under each");
  command.flag(
      "--live", options->live,
      "In place of a video the running daemon's camera: says what to do, and the daemon keeps the person");
  command
      .option("-o,--output", options->person,
              "The file to write, NAME.person; must not exist yet. It is biometric data: whoever has it can "
              "recognise the face. Default: NAME.person of --name, in the folder of persons; with --improve "
              "the file of who is known")
      .ends_in({".person"});
  command.option("--name", options->name,
                 "The person's name; default: the file's, and with --improve that of who is known");
  command.option("--improve", options->improve,
                 "A person who is known already, by name or file: the mean of both shapes, each weighted by "
                 "how certain it is, goes in the place of the first one (with -o into that file). Refused "
                 "where it is another head");
  command.option(
      "--config", options->config,
      "Configuration file; of [source], only frames and intrinsics count; the skin's relief is refined on "
      "the device of [gpu]. Its [persons] folder is where the person goes, without it that of the "
      "installed configuration");
  command.option("--frames", options->frames, kFramesHelp);
  command.option("--burst", options->burst,
                 "Frames A:B of the video in which the head is still and lamps are switched on in turn, each "
                 "for three frames and more: they tell of the skin's relief");
  command.option("--socket", options->socket,
                 "With --live: the daemon's control socket; default: that of its configuration");
  command.callback([options] { options->live ? run_live(*options) : run(*options); });
}

}  // namespace facet::tools
