// `facet animate`: key frames or a random walk over a take's faces.

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "animate/animation.hpp"
#include "animate/places.hpp"
#include "animate/streaming_basis.hpp"
#include "animate_options.hpp"
#include "exports/export.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"
#include "progress.hpp"
#include "render/video_writer.hpp"
#include "report/film.hpp"
#include "report/take_pictures.hpp"
#include "stop_signals.hpp"
#include "take/recorder.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

constexpr int kVideoWidth_px = 640;
constexpr int kVideoHeight_px = 720;

struct AnimateOptions {
  BasisChoice basis;
  std::string keys;
  std::string walk;
  std::uint64_t seed = 1;
  double mean_run_s = animate::WalkOptions{}.mean_run_s;
  std::vector<std::string> regions;
  std::string head = "still";
  double rate_hz = 0;
  bool report = false;
  std::string output;
};

/// "30s", "1.5min" or "30": seconds.
double parse_duration(const std::string& text) {
  double value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const std::string unit(stop, text.data() + text.size());
  if (error != std::errc() || !std::isfinite(value) || !(unit.empty() || unit == "s" || unit == "min")) {
    throw Error(ErrorKind::Usage, fmt::format("--walk {}: give a time as in 30s or 2min", text));
  }
  return unit == "min" ? 60 * value : value;
}

/// The animation's frames, one after the other.
class Frames {
 public:
  Frames(const animate::Animation& animation, double rate_hz, animate::HeadMotion head)
      : animation_(animation),
        rate_hz_(rate_hz),
        head_(head),
        blank_(animate::blank_frame(animation.basis())) {
    count_ = std::max<std::int64_t>(1, std::llround(animation.duration_s() * rate_hz));
  }

  std::int64_t count() const { return count_; }
  double time_s(std::int64_t index) const { return static_cast<double>(index) / rate_hz_; }

  std::shared_ptr<const mesh::MeshFrame> at(std::int64_t index) {
    auto frame = std::make_shared<mesh::MeshFrame>(blank_);
    animation_.pose(time_s(index), pose_);
    animate::blend(animation_.basis(), pose_, *frame);
    frame->camera_from_head = animation_.camera_from_head(time_s(index), head_);
    frame->sequence = static_cast<std::uint64_t>(index);
    frame->media_time_ns = std::llround(time_s(index) * 1e9);
    frame->timestamp_ns = frame->media_time_ns;
    return frame;
  }

 private:
  const animate::Animation& animation_;
  double rate_hz_;
  animate::HeadMotion head_;
  mesh::MeshFrame blank_;
  animate::Pose pose_;
  std::int64_t count_ = 0;
};

/// Calls work for every frame; false where a signal broke it off.
bool for_each(Frames& frames, const char* what, const StopSignals& signals,
              const std::function<void(std::int64_t, const std::shared_ptr<const mesh::MeshFrame>&)>& work) {
  Progress progress(what, static_cast<std::uint64_t>(frames.count()));
  for (std::int64_t index = 0; index < frames.count(); ++index) {
    if (signals.pending() != 0) {
      return false;
    }
    work(index, frames.at(index));
    progress.advance();
  }
  return true;
}

bool write_take(Frames& frames, const AnimateOptions& options, const StopSignals& signals) {
  take::TakeRecorderConfig config;
  config.file = options.output;
  config.source = fmt::format("{} of {}", options.keys.empty() ? "walk " + options.walk : options.keys,
                              options.basis.take);
  config.software = fmt::format("facet animate {}", FACET_VERSION);
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  const bool whole = for_each(frames, "Animating", signals,
                              [&](std::int64_t, const auto& frame) { recorder.record(frame); });
  const take::RecorderStatus status = recorder.stop();
  if (!whole) {
    std::error_code ignored;
    std::filesystem::remove(options.output, ignored);
    return false;
  }
  if (status.state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", options.output, status.reason));
  }
  return true;
}

CameraIntrinsics film_camera(Frames& frames) {
  constexpr std::int64_t kMostLooks = 120;
  const std::int64_t step = std::max<std::int64_t>(1, frames.count() / kMostLooks);
  std::vector<report::FilmLook> looks;
  for (std::int64_t index = 0; index < frames.count(); index += step) {
    const auto frame = frames.at(index);
    looks.push_back({report::face_vertices(*frame), frame->camera});
  }
  return report::film_cell(looks, kVideoWidth_px, kVideoHeight_px).camera;
}

bool write_video(Frames& frames, const AnimateOptions& options, double rate_hz, const StopSignals& signals) {
  const CameraIntrinsics camera = film_camera(frames);
  const bool is_film = std::filesystem::path(options.output).extension() == ".mp4";
  render::VideoWriter video(options.output,
                            {kVideoWidth_px,
                             kVideoHeight_px,
                             is_film ? rate_hz : std::round(rate_hz),
                             is_film ? render::VideoCodec::Film : render::VideoCodec::Lossless,
                             {},
                             {}});
  const bool whole = for_each(frames, "Drawing", signals, [&](std::int64_t, const auto& frame) {
    video.append(draw_face(*frame, camera));
  });
  if (whole) {
    video.finish();
  }
  return whole;
}

bool write_glb(Frames& frames, const AnimateOptions& options, double rate_hz, const StopSignals& signals) {
  exports::SequenceOptions sequence;
  sequence.file = options.output;
  sequence.timeline.rate_hz = rate_hz;
  for (std::int64_t index = 0; index < frames.count(); ++index) {
    sequence.timeline.sequences.push_back(static_cast<std::uint64_t>(index));
  }
  std::unique_ptr<exports::SequenceWriter> writer;
  exports::SequenceFrame next;
  const bool whole = for_each(frames, "Writing", signals, [&](std::int64_t, const auto& frame) {
    next.sequence = frame->sequence;
    next.camera_from_head = frame->camera_from_head;
    next.expression = frame->expression;
    exports::build_export_mesh(*frame, exports::MeshLevel::Finest, exports::MeshSpace::Head, next.mesh);
    if (writer == nullptr) {
      writer = exports::open_glb_frames(sequence, next);
    }
    writer->add(next);
  });
  if (whole) {
    writer->commit();
  }
  return whole;
}

void print_report(const animate::AnimationReport& report, bool all) {
  for (const std::string& warning : report.warnings) {
    tell(stderr, "facet animate: {}\n", warning);
  }
  if (all) {
    tell("{:>9} {:>6} {:>7} {:>9} {:>9} {:>9} {:>6} {:>6} {:>12} {:>7}\n", "keys", "region", "offset", "path",
         "shortest", "direct", "faces", "jumps", "worst step", "speed");
  }
  const animate::TransitionReport* worst = nullptr;
  for (const animate::TransitionReport& one : report.transitions) {
    if (all) {
      tell("{:>4}->{:<3} {:>6} {:>7.2f} {:>9.2f} {:>9.2f} {:>9.2f} {:>6} {:>6} {:>6.2f} at {:<5} {:>5.2f}\n",
           one.key + 1, one.key + 2, one.region + 1, one.key_offset_mm, one.cost, one.shortest_cost,
           one.direct_cost, one.faces, one.jumps, one.worst_cost, one.worst_frame, one.speed);
    }
    worst = worst == nullptr || one.worst_cost > worst->worst_cost ? &one : worst;
  }
  if (worst != nullptr) {
    tell("worst transition: {:.2f} mm after frame {}, between keys {} and {} in region {}\n",
         worst->worst_cost, worst->worst_frame, worst->key + 1, worst->key + 2, worst->region + 1);
  }
  if (report.jumps > 0) {
    tell("{} jumps, the worst {:.2f} mm after frame {}\n", report.jumps, report.worst_jump_cost,
         report.worst_jump_frame);
  }
}

void run_animate(const AnimateOptions& options) {
  if (options.keys.empty() == options.walk.empty()) {
    throw Error(ErrorKind::Usage, "give either --keys FILE or --walk TIME");
  }
  std::optional<animate::KeyList> keys;
  if (!options.keys.empty()) {
    keys = animate::read_keys(options.keys);
  }
  const StopSignals signals;
  const auto basis = open_basis(options.basis, signals);
  animate::AnimationReport report;
  std::optional<animate::Animation> animation;
  const animate::GoOn go_on = [&signals] { return signals.pending() == 0; };
  const auto prepare = [&] {
    if (keys) {
      for (const std::string& region : options.regions) {
        keys->regions.push_back(region);
      }
      animation = animate::Animation::of_keys(basis, *keys, report, go_on);
      return;
    }
    animate::WalkOptions walk;
    walk.duration_s = parse_duration(options.walk);
    walk.seed = options.seed;
    walk.mean_run_s = options.mean_run_s;
    for (const std::string& region : options.regions) {
      walk.regions.push_back(animate::find_vertex(*basis, region));
    }
    animation = animate::Animation::of_walk(basis, walk, report, go_on);
  };
  try {
    prepare();
  } catch (const Error&) {
    end_where_broken_off(signals, options.output);
    throw;
  }
  print_report(report, options.report);
  const double rate_hz = options.rate_hz > 0         ? options.rate_hz
                         : keys && keys->rate_hz > 0 ? keys->rate_hz
                                                     : 1.0 / basis->frame_period_s();
  Frames frames(*animation, rate_hz,
                options.head == "captured" ? animate::HeadMotion::Captured : animate::HeadMotion::Still);
  const std::string extension = std::filesystem::path(options.output).extension();
  const bool whole = extension == ".take"  ? write_take(frames, options, signals)
                     : extension == ".glb" ? write_glb(frames, options, rate_hz, signals)
                                           : write_video(frames, options, rate_hz, signals);
  if (!whole) {
    end_where_broken_off(signals, options.output);
  }
  basis->check_unchanged();
  tell("{}: {} frames, {:.2f} s\n", options.output, frames.count(), frames.time_s(frames.count()));
}

}  // namespace

void add_animate_command(Command app) {
  auto options = std::make_shared<AnimateOptions>();
  const Command command =
      app.subcommand("animate", "Animate a take's face: key frames, or an endless idle as a random walk");
  add_basis_options(command, options->basis);
  command.option("--keys", options->keys, "Key poses and their times (JSON, docs/animation.md)");
  command.option("--walk", options->walk, "A random walk of this time, as in 30s or 2min").excludes("--keys");
  command.option("--seed", options->seed, "Of the walk").shows_default();
  command.option("--mean-run", options->mean_run_s, "Seconds between the walk's jumps on average")
      .shows_default()
      .range(0.3, 600.0);
  command
      .option("--region", options->regions,
              "A vertex or place with a soft region that moves on its own; any number")
      .one_at_a_time();
  command.option("--head", options->head, "still, or captured: turns as in the take, forwards and backwards")
      .shows_default()
      .one_of({"still", "captured"});
  command.option("--rate", options->rate_hz, "Frames per second (default: the keys file's, or the take's)")
      .range(1.0, 1000.0);
  command.flag("--report", options->report, "Print every transition");
  command
      .option("-o,--output", options->output,
              "anim.take: a take like any other; anim.glb: one animated mesh; anim.mp4, anim.mkv: a film of "
              "it in "
              "grey, small or without loss")
      .required()
      .ends_in({".take", ".glb", ".mp4", ".mkv"});
  command.callback([options] { run_animate(*options); });
}

}  // namespace facet::tools
