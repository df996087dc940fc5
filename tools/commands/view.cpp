// `facet view`: a contact sheet of a take.

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <memory>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "booth/template_subject.hpp"
#include "capture/rig_file.hpp"
#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "fit/template_mesh.hpp"
#include "maths/statistics.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "report/booth_sheet.hpp"
#include "report/sheet.hpp"
#include "take_frames.hpp"
#include "tell.hpp"
#include "terminal_picture.hpp"

namespace facet::tools {
namespace {

constexpr std::size_t kDefaultRows = 5;
constexpr std::size_t kMostRows = 40;  // PNG pictures of more are no longer fit to be looked at

struct ViewOptions {
  std::string take;
  std::string sheet;
  std::string frames;
  std::string video;
  std::string rig;
  std::string pictures;
  std::string depth;
  std::string truth;
  std::string model;
  bool terminal = false;
};

constexpr int kDefaultColumns = 120;  // where what is printed goes to no terminal

/// In the place of a sheet: one row of it in the terminal, its left half above the right one.
void print_row(const render::Picture& row) {
  const int columns = terminal_columns(stdout);
  const int half_px = row.width_px / 2;
  for (const int left : {0, half_px}) {
    render::Picture half;
    half.width_px = half_px;
    half.height_px = row.height_px;
    for (int y = 0; y < row.height_px; ++y) {
      const auto from = row.rgb.begin() + 3 * (static_cast<std::ptrdiff_t>(y) * row.width_px + left);
      half.rgb.insert(half.rgb.end(), from, from + std::ptrdiff_t{3} * half_px);
    }
    const std::string text =
        terminal_picture(half, columns > 0 ? columns : kDefaultColumns, terminal_has_true_colour());
    std::fwrite(text.data(), 1, text.size(), stdout);
  }
}

/// The frames asked for: "A,B,C" (each one), "A:B" or nothing (spread evenly over those with a mesh), by
/// Frame::sequence. returns indices in the take.
std::vector<std::int64_t> chosen_frames(take::TakeReader& take, const std::string& text) {
  const bool is_list =
      text.find(',') != std::string::npos || (!text.empty() && text.find(':') == std::string::npos);
  std::vector<std::int64_t> chosen;
  if (is_list) {
    for (std::size_t at = 0; at <= text.size();) {
      const std::size_t end = std::min(text.find(',', at), text.size());
      std::uint64_t sequence = 0;
      const auto [stop, error] = std::from_chars(text.data() + at, text.data() + end, sequence);
      if (error != std::errc() || stop != text.data() + end) {
        throw Error(
            ErrorKind::Usage,
            fmt::format("--frames {}: give frame numbers as in 0,50,100, or a range as in 100:200", text));
      }
      for (std::int64_t index = 0; index < take.frame_count(); ++index) {
        if (take.entry(index).sequence == sequence) {
          chosen.push_back(index);
        }
      }
      at = end + 1;
    }
  } else {
    const std::vector<std::int64_t> any = frames_in_range(take, text);
    std::vector<std::int64_t> with_mesh;
    std::copy_if(any.begin(), any.end(), std::back_inserter(with_mesh),
                 [&](std::int64_t index) { return take.entry(index).has_mesh; });
    chosen = report::spread_evenly(with_mesh.empty() ? any : with_mesh, kDefaultRows);
  }
  if (chosen.empty() || chosen.size() > kMostRows) {
    throw Error(ErrorKind::Usage,
                fmt::format("--frames {}: {} of the take's {} frames are chosen; a sheet holds 1 to {}", text,
                            chosen.size(), take.frame_count(), kMostRows));
  }
  return chosen;
}

/// The take that a booth's meshes were made of: the one given, or the one that the take names.
std::optional<take::TakeReader> open_pictures(const take::TakeReader& take, const std::string& given) {
  std::error_code ignored;
  const std::string source = given.empty() ? take.info().source : given;
  if (!given.empty() || std::filesystem::is_regular_file(source, ignored)) {
    return take::TakeReader(source);
  }
  tell(stderr, "facet view: the take's source '{}' is not here; give it with --pictures\n", source);
  return std::nullopt;
}

/// " (ada)" where an enrolled person was followed.
std::string person_of(take::TakeReader& take, const std::vector<std::int64_t>& frames) {
  for (const std::int64_t index : frames) {
    if (const auto subject = take.frame(index)->subject; subject != nullptr && !subject->person.empty()) {
      return fmt::format(" ({})", subject->person);
    }
  }
  return "";
}

/// The parts of the face that a booth's template is of, where the face model is at hand.
std::vector<face::FacePart> parts_of_template(const std::string& given) {
  const std::filesystem::path file = given.empty() ? default_model_file() : std::filesystem::path(given);
  std::error_code ignored;
  if (given.empty() && !std::filesystem::exists(file, ignored)) {
    return {};
  }
  try {
    const face::FaceModel model = face::FaceModel::load(file);
    return model.landmarks.empty() ? std::vector<face::FacePart>()
                                   : booth::template_parts(fit::make_template(model), model);
  } catch (const Error&) {
    if (!given.empty()) {
      throw;
    }
    return {};  // it may not be the take's
  }
}

/// One line for each part of the face, over all meshes whose truth is known.
void tell_parts(const std::vector<report::BoothError>& errors) {
  for (std::size_t part = 0; part < face::kFacePartNames.size(); ++part) {
    std::vector<float> distances;
    double normals_deg = 0;
    for (const report::BoothError& error : errors) {
      const report::PointErrors& points = error.parts.at(part);
      distances.insert(distances.end(), points.distance_mm.begin(), points.distance_mm.end());
      normals_deg += std::accumulate(points.normal_deg.begin(), points.normal_deg.end(), 0.0);
    }
    if (distances.empty()) {
      continue;
    }
    const auto count = static_cast<double>(distances.size());
    const double mean = std::accumulate(distances.begin(), distances.end(), 0.0) / count;
    tell("{:<13} {:.3f} mm (mean; median: {:.3f}, 95 %: {:.3f} mm), normals {:.1f} degrees off\n",
         std::string(face::kFacePartNames.at(part)) + ":", mean, maths::quantile_of(distances, 0.5),
         maths::quantile_of(distances, 0.95), normals_deg / count);
  }
}

void view_booth(const ViewOptions& options, take::TakeReader& take, const std::vector<std::int64_t>& frames) {
  std::optional<take::TakeReader> pictures = open_pictures(take, options.pictures);
  report::BoothSheetSources sources;
  sources.meshes = &take;
  sources.pictures = pictures ? &*pictures : nullptr;
  sources.rig = capture::read_rig(options.rig);
  sources.depth_folder = options.depth;
  sources.truth_folder = options.truth;
  if (!options.truth.empty()) {
    sources.parts = parts_of_template(options.model);
  }
  std::vector<report::BoothError> errors;
  Progress progress("Drawing", frames.size(), "rows");
  const render::Picture sheet = report::make_booth_sheet(
      sources, frames, [&](int rows) { progress.set(static_cast<std::uint64_t>(rows)); }, errors);
  progress.finish();
  render::write_png(sheet, options.sheet);
  for (const report::BoothError& error : errors) {
    const std::string wrinkles = std::isnan(error.wrinkle_correlation)
                                     ? ""
                                     : fmt::format(", wrinkles at {:.2f} of their depth (correlation {:.2f})",
                                                   error.wrinkle_depth, error.wrinkle_correlation);
    tell("slot {}: {:.3f} mm from the truth (mean; 95 %: {:.3f} mm), normals {:.1f} degrees off{}\n",
         error.slot, error.mean_mm, error.p95_mm, error.normal_deg, wrinkles);
  }
  tell_parts(errors);
  tell("{}: {} frames of {}\n", options.sheet, frames.size(), options.take);
}

void run_view(const ViewOptions& options) {
  if (options.sheet.empty() && !options.terminal) {
    throw Error(ErrorKind::Usage, "name a PNG to write with -o, or look at one frame here with --terminal");
  }
  take::TakeReader take(options.take);
  auto frames = chosen_frames(take, options.frames);
  if (options.sheet.empty()) {
    frames = {frames[frames.size() / 2]};
  }
  if (!options.rig.empty()) {
    view_booth(options, take, frames);
    return;
  }
  const auto images = report::open_source_images(take.info(), options.video);
  if (!images) {
    tell(stderr,
         "facet view: the take holds no pictures, and its source '{}' is not a video file here; give it with "
         "--video\n",
         take.info().source);
  }
  Progress progress("Drawing", frames.size(), "rows");
  const render::Picture sheet = report::make_sheet(
      take, frames, images.get(), [&](int rows) { progress.set(static_cast<std::uint64_t>(rows)); });
  progress.finish();
  if (options.terminal) {
    print_row(options.sheet.empty()
                  ? sheet
                  : report::make_sheet(take, {frames[frames.size() / 2]}, images.get(), [](int) {}));
  }
  if (options.sheet.empty()) {
    return;
  }
  render::write_png(sheet, options.sheet);
  tell("{}: {} frames of {}{}\n", options.sheet, frames.size(), options.take, person_of(take, frames));
}

}  // namespace

void add_view_command(Command app) {
  auto options = std::make_shared<ViewOptions>();
  const Command command = app.subcommand(
      "view", "Draw a sheet of a take: input, coarse mesh, normals, shaded mesh, albedo, photometric error");
  command.option("take", options->take, "Take file").required();
  command.option("-o,--output", options->sheet, "PNG to write");
  command.option("--frames", options->frames,
                 "Frames of the source by number as in 0,50,100, or a range A:B without B, of which five "
                 "are drawn; default: the whole take");
  command.option("--video", options->video, "The video that the take was made from, where it has moved");
  command.option(
      "--rig", options->rig,
      "A booth's rig file, for a take that `facet process --rig` made: draws pattern, depth, mesh over the "
      "picture, shaded mesh, texture, error");
  command
      .flag("--terminal", options->terminal,
            "Print one frame here in coloured half blocks, where there is no screen: the row of the sheet in "
            "two "
            "halves, the frame in the middle of those chosen")
      .excludes("--rig");
  command.option("--pictures", options->pictures, "The take that the meshes were made of, where it has moved")
      .needs("--rig");
  command.option("--depth", options->depth, "The folder that `facet process --depth` wrote").needs("--rig");
  command
      .option("--truth", options->truth,
              "The folder that `facet synth-booth` wrote, where the pictures are of the virtual booth")
      .needs("--rig");
  command
      .option("--model", options->model,
              "The face model that the meshes were made with, for the parts of the face; default: the one "
              "that is installed")
      .needs("--truth");
  command.callback([options] { run_view(*options); });
}

}  // namespace facet::tools
