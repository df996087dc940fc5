// `facet summary TAKE`: what is in a take, and how fast and how well it was made.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "take/closing.hpp"
#include "take/reader.hpp"
#include "take_sound.hpp"
#include "take_stages.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct Options {
  std::string take;
  bool last_mesh_frame = false;
  bool verify = false;
  bool close = false;
};

/// What the frame sets of a take hold.
struct PictureFigures {
  struct Camera {
    std::string name;
    int width_px = 0;  ///< of its last picture
    int height_px = 0;
    std::int64_t pictures = 0;
    std::int64_t corrupt = 0;
  };
  std::vector<Camera> cameras;
  std::int64_t sets = 0;
  std::int64_t complete = 0;

  void add(const FrameSet& set) {
    ++sets;
    complete += set.complete() ? 1 : 0;
    for (std::size_t i = 0; i < set.frames.size(); ++i) {
      if (i == cameras.size()) {
        cameras.push_back({set.camera_names->at(i)});
      }
      if ((set.missing >> i & 1U) == 0) {
        Camera& camera = cameras[i];
        camera.width_px = set.frames[i].width_px;
        camera.height_px = set.frames[i].height_px;
        ++camera.pictures;
        camera.corrupt += set.frames[i].corrupt ? 1 : 0;
      }
    }
  }
};

/// The p-quantile (0 to 1) of unsorted values; 0 for none.
float quantile(std::vector<float> values, double p) {
  return values.empty() ? 0 : maths::quantile_of(values, p);
}

float mean(const std::vector<float>& values) {
  double sum = 0;
  for (const float value : values) {
    sum += value;
  }
  return values.empty() ? 0.0F : static_cast<float>(sum / static_cast<double>(values.size()));
}

void print_last_mesh_frame(take::TakeReader& reader) {
  for (std::int64_t i = reader.frame_count() - 1; i >= 0; --i) {
    if (const take::FrameEntry entry = reader.entry(i); entry.has_mesh) {
      tell("{}\n", entry.sequence);
      return;
    }
  }
  throw Error(ErrorKind::NoFace,
              fmt::format("{}: no frame of this take has a mesh", reader.info().file.string()));
}

void print_pictures(const PictureFigures& figures, const take::TakeInfo& info, double rate_hz) {
  tell("pictures      {} cameras; {} sets, {} complete\n", figures.cameras.size(), figures.sets,
       figures.complete);
  for (const PictureFigures::Camera& camera : figures.cameras) {
    tell("  {:<12}{}x{}, {} pictures, missing in {} sets{}\n", camera.name, camera.width_px, camera.height_px,
         camera.pictures, figures.sets - camera.pictures,
         camera.corrupt > 0 ? fmt::format(", {} damaged as the driver says", camera.corrupt) : "");
  }
  std::uint64_t bytes = 0;
  std::int64_t sets = 0;
  for (const take::TakeSegment& segment : info.segments) {
    bytes += segment.bytes;
    sets += segment.frame_count;
  }
  if (sets > 0) {
    const double megabytes_a_set = static_cast<double>(bytes) / 1e6 / static_cast<double>(sets);
    tell("segments      {}, {:.2f} MB a set{}\n", info.segments.size(), megabytes_a_set,
         rate_hz > 0 ? fmt::format(", {:.1f} MB a second", megabytes_a_set * rate_hz) : "");
  }
}

/// The segments that can't be read whole; how many.
int print_faults(take::TakeReader& reader) {
  int faults = 0;
  for (const take::TakeSegment& segment : reader.info().segments) {
    if (!segment.fault.empty()) {
      ++faults;
      tell("damaged       {} (frames {} to {})\n", segment.fault, reader.entry(segment.first_frame).sequence,
           reader.entry(segment.last_frame).sequence);
    }
  }
  return faults;
}

/// Reads every picture. Throws Error(UnreadableInput) where one is damaged.
void verify(take::TakeReader& reader) {
  std::int64_t damaged = 0;
  Progress progress("Verifying", static_cast<std::uint64_t>(reader.frame_count()));
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    try {
      reader.frame(i);
    } catch (const Error& error) {
      constexpr std::int64_t kMostNamed = 20;
      if (++damaged <= kMostNamed) {
        tell("damaged       {}\n", error.what());
      }
    }
    progress.advance();
  }
  progress.finish();
  if (damaged > 0) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: {} of {} frames are damaged", reader.info().file.string(), damaged,
                            reader.frame_count()));
  }
  tell("verified      {} frames with all their pictures\n", reader.frame_count());
}

/// Throws Error(Storage) where the take can't be closed now.
void close(const std::string& file) {
  const take::ClosedTake take = take::close_take(file);
  if (!take.left.empty()) {
    throw Error(ErrorKind::Storage, fmt::format("take '{}': {}", file, take.left));
  }
}

/// What the frames of a take say of themselves.
struct TakeFigures {
  std::array<std::int64_t, 4> states{};
  std::array<std::vector<float>, kStages.size()> times_ms;
  std::vector<float> photometric_rms;
  std::vector<float> reprojection_px;
  std::int64_t refined = 0;
  std::int64_t degraded = 0;
  std::int64_t finest_vertices = 0;
  std::size_t levels = 0;
  std::string degraded_reason;
  std::string person;  ///< whose enrolled shape was followed
  PictureFigures pictures;

  void add(const mesh::MeshFrame& frame) {
    ++states[static_cast<std::size_t>(frame.state)];
    if (frame.images != nullptr) {
      pictures.add(*frame.images);
    }
    if (frame.degraded) {
      ++degraded;
      degraded_reason = frame.degraded_reason;
    }
    if (frame.subject != nullptr) {
      person = frame.subject->person;
    }
    for (std::size_t s = 0; s < kStages.size(); ++s) {
      if (const float time_ms = frame.stage_ms.*(kStages[s].time_ms); time_ms > 0) {
        times_ms[s].push_back(time_ms);
      }
    }
    if (frame.state == mesh::TrackingState::Tracking) {
      reprojection_px.push_back(frame.reprojection_px);
    }
    if (!frame.displacements_mm.empty()) {
      ++refined;
      photometric_rms.push_back(frame.photometric_rms);
      finest_vertices = static_cast<std::int64_t>(frame.displacements_mm.size());
      levels = frame.subject->hierarchy->levels.size();
    }
  }
};

TakeFigures read(take::TakeReader& reader) {
  TakeFigures figures;
  Progress progress("Reading", static_cast<std::uint64_t>(reader.frame_count()));
  for (std::int64_t i = 0; i < reader.frame_count(); ++i) {
    figures.add(*reader.frame(i, take::Pictures::Described));
    progress.advance();
  }
  return figures;
}

void print_take(const take::TakeInfo& info) {
  tell("take          {}\n", info.file.string());
  tell("source        {}\n", info.source);
  tell("recorded      {} by {}{}\n", info.created_utc, info.software,
       info.closed ? "" : " (not closed: still recorded, or broken off: --close)");
  if (!info.end_reason.empty()) {
    tell("ended         {}\n", info.end_reason);
  }
}

void print_frames(const TakeFigures& figures, const take::TakeInfo& info, std::int64_t frame_count,
                  double rate_hz) {
  const auto count = [&](mesh::TrackingState state) {
    return figures.states[static_cast<std::size_t>(state)];
  };
  tell("frames        {} ({} tracking, {} acquiring, {} searching, {} lost; {} refined; {} not recorded)\n",
       frame_count, count(mesh::TrackingState::Tracking), count(mesh::TrackingState::Acquiring),
       count(mesh::TrackingState::Searching), count(mesh::TrackingState::Lost), figures.refined,
       info.dropped);
  if (figures.degraded > 0) {
    tell("degraded      {} frame{}, the last one because: {}\n", figures.degraded,
         figures.degraded == 1 ? "" : "s", figures.degraded_reason);
  }
  if (!figures.person.empty()) {
    tell("person        {}\n", figures.person);
  }
  if (figures.refined > 0) {
    tell("mesh          {} vertices on the finest of {} levels\n", figures.finest_vertices, figures.levels);
  }
  if (rate_hz > 0) {
    tell("rate          {:.2f} frames per second\n", rate_hz);
  }
  tell("size          {:.1f} MB, {:.1f} KB a frame\n", static_cast<double>(info.file_bytes) / 1e6,
       static_cast<double>(info.file_bytes) / 1e3 /
           static_cast<double>(std::max<std::int64_t>(1, frame_count)));
}

void print_errors_and_times(const TakeFigures& figures) {
  // A booth's meshes lie on depth maps: nothing is reprojected there, nor compared with shading.
  if (!figures.reprojection_px.empty() && quantile(figures.reprojection_px, 1.0) > 0) {
    tell("reprojection  {:.2f} px median of the frames' medians\n", quantile(figures.reprojection_px, 0.5));
  }
  if (!figures.photometric_rms.empty() && quantile(figures.photometric_rms, 1.0) > 0) {
    tell("photometric   {:.4f} mean rms error, {:.4f} worst frame (linear light, 0 to 1)\n",
         mean(figures.photometric_rms), quantile(figures.photometric_rms, 1.0));
  }
  tell("\n{:<24} {:>9} {:>9} {:>9} {:>8}\n", "stage", "mean ms", "median", "p95", "frames");
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    if (const std::vector<float>& times_ms = figures.times_ms[s]; !times_ms.empty()) {
      tell("{:<24} {:>9.2f} {:>9.2f} {:>9.2f} {:>8}\n", kStages[s].name, mean(times_ms),
           quantile(times_ms, 0.5), quantile(times_ms, 0.95), times_ms.size());
    }
  }
}

void run(const Options& options) {
  if (options.close) {
    close(options.take);
  }
  take::TakeReader reader(options.take);
  if (options.last_mesh_frame) {
    print_last_mesh_frame(reader);
    return;
  }
  const take::TakeInfo& info = reader.info();
  const TakeFigures figures = read(reader);
  const double seconds = info.duration_s;
  const double rate_hz =
      reader.frame_count() > 1 && seconds > 0 ? static_cast<double>(reader.frame_count() - 1) / seconds : 0;
  print_take(info);
  print_frames(figures, info, reader.frame_count(), rate_hz);
  print_time(reader);
  // Of a camera whose pictures were not recorded frames only say how large they were.
  const bool holds_pictures = info.picture_bytes > 0 || info.format_version < 2;
  if (figures.pictures.sets > 0 && holds_pictures) {
    print_pictures(figures.pictures, info, rate_hz);
  }
  const int faults = print_faults(reader);
  print_errors_and_times(figures);
  if (options.verify) {
    tell("\n");
    verify(reader);
  } else if (faults > 0) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {} of {} segments can't be read whole",
                                                        info.file.string(), faults, info.segments.size()));
  }
}

}  // namespace

void add_summary_command(Command app) {
  auto options = std::make_shared<Options>();
  const Command command = app.subcommand(
      "summary", "What is in a take: frames by state, pictures, rate, times per stage, errors");
  command.option("take", options->take, "The take").required();
  command.flag("--last-mesh-frame", options->last_mesh_frame,
               "Print only the number, in the source, of the last frame that has a mesh");
  command.flag("--verify", options->verify,
               "Read every frame with its pictures and name those that are damaged");
  command.flag("--close", options->close,
               "First close a take that was broken off and fold in the log beside it, where nobody has "
               "it open");
  command.callback([options] { run(*options); });
}

}  // namespace facet::tools
