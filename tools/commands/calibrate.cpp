// `facet calibrate`: from pictures of a board, a raw take or a running facetd to a rig file.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "calibration/board.hpp"
#include "calibration/calibrator.hpp"
#include "calibration/footage.hpp"
#include "calibration/report_pictures.hpp"
#include "capture/rig_file.hpp"
#include "daemon_options.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"
#include "stop_signals.hpp"
#include "stream/client.hpp"
#include "take/reader.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
using calibration::Board;
using calibration::Footage;
using calibration::SetCollector;

struct BoardArguments {
  std::string kind = "charuco";
  std::string squares = "9x7";
  double square_mm = 20;
  double marker_mm = 0;  // 0: three quarters of the square
  std::string dictionary = "4X4_250";
};

struct Arguments {
  BoardArguments board;
  calibration::DetectorOptions detector;
  calibration::CalibratorOptions calibrator;
  std::vector<std::string> pairs;
  std::vector<std::string> colour;
  std::string output;
  std::vector<std::string> folders;  // CAMERA=FOLDER
  std::string take;
  std::shared_ptr<StreamOptions> stream;
  std::string save;
  std::size_t views = 40;
};

/// "9x7" as two numbers.
std::pair<int, int> parse_squares(const std::string& text) {
  const std::size_t cross = text.find('x');
  const auto number = [](const std::string& digits) {
    const bool fine =
        !digits.empty() && digits.size() <= 3 &&
        std::all_of(digits.begin(), digits.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
    return fine ? std::stoi(digits) : 0;
  };
  const int columns = cross == std::string::npos ? 0 : number(text.substr(0, cross));
  const int rows = cross == std::string::npos ? 0 : number(text.substr(cross + 1));
  if (columns == 0 || rows == 0) {
    throw Error(ErrorKind::Usage, fmt::format("--squares {}: must be COLUMNSxROWS, such as 9x7", text));
  }
  return {columns, rows};
}

Board board_of(const BoardArguments& arguments) {
  Board board;
  board.kind =
      arguments.kind == "charuco" ? calibration::BoardKind::Charuco : calibration::BoardKind::Checkerboard;
  std::tie(board.columns, board.rows) = parse_squares(arguments.squares);
  board.square_mm = arguments.square_mm;
  board.marker_mm = arguments.marker_mm > 0 ? arguments.marker_mm : 0.75 * arguments.square_mm;
  board.dictionary = arguments.dictionary;
  calibration::check(board);
  return board;
}

/// Pictures of a folder by name without extension.
std::map<std::string, std::filesystem::path> pictures_of(const std::filesystem::path& folder) {
  std::map<std::string, std::filesystem::path> pictures;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (extension == ".png" || extension == ".jpg" || extension == ".jpeg") {
      const auto [at, added] = pictures.emplace(entry.path().stem().string(), entry.path());
      if (!added) {
        throw Error(ErrorKind::UnreadableInput, fmt::format("'{}' and '{}' are of one moment by their name",
                                                            at->second.string(), entry.path().string()));
      }
    }
  }
  if (error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}': cannot read this folder: {}", folder.string(), error.message()));
  }
  if (pictures.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}': there is no .png, .jpg or .jpeg file in this folder", folder.string()));
  }
  return pictures;
}

Footage read_folders(const Arguments& arguments, const calibration::BoardDetector& detector) {
  Footage footage;
  std::vector<std::map<std::string, std::filesystem::path>> pictures;
  std::map<std::string, int> moments;
  std::uint64_t total = 0;
  for (const std::string& given : arguments.folders) {
    const std::size_t equals = given.find('=');
    if (equals == std::string::npos || equals == 0 || equals + 1 == given.size()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("'{}': must be CAMERA=FOLDER, such as left=shots/left", given));
    }
    const std::string name = given.substr(0, equals);
    for (const calibration::CalibrationCamera& other : footage.cameras) {
      if (other.name == name) {
        throw Error(ErrorKind::Usage, fmt::format("camera '{}' is given twice", name));
      }
    }
    footage.cameras.push_back({name, 0, 0, false});
    pictures.push_back(pictures_of(given.substr(equals + 1)));
    for (const auto& [moment, file] : pictures.back()) {
      ++moments[moment];
    }
    total += pictures.back().size();
  }
  for (std::size_t camera = 0; camera < pictures.size() && pictures.size() > 1; ++camera) {
    const bool shares = std::any_of(pictures[camera].begin(), pictures[camera].end(),
                                    [&](const auto& picture) { return moments[picture.first] > 1; });
    if (!shares) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format(
              "camera '{}': none of its pictures, such as {}, has the name of another camera's: files "
              "of one name belong to one moment",
              footage.cameras[camera].name, pictures[camera].begin()->second.string()));
    }
  }
  Progress progress("Finding the board", total, "pictures");
  for (const auto& [moment, count] : moments) {
    footage.views.push_back({moment, {}});
    for (std::size_t camera = 0; camera < pictures.size(); ++camera) {
      const auto at = pictures[camera].find(moment);
      Frame frame;
      if (at != pictures[camera].end()) {
        frame = render::to_frame(render::read_image(at->second));
        calibration::admit(footage.cameras[camera], frame, at->second.string());
        progress.advance();
      }
      footage.views.back().seen.push_back(detector.detect(frame));
    }
  }
  progress.finish();
  return footage;
}

std::string coverage_text(const SetCollector& collector) {
  std::vector<std::string> parts;
  for (std::size_t camera = 0; camera < collector.coverage().size(); ++camera) {
    parts.push_back(fmt::format("{:.0f}", 100 * collector.coverage()[camera].part()));
  }
  return fmt::format("covered {} %", fmt::join(parts, " "));
}

/// Throws Error(UnreadableInput) where nothing was kept.
void require_views(const SetCollector& collector) {
  if (collector.kept() == 0) {
    throw Error(ErrorKind::UnreadableInput,
                "no view was taken: the board was never seen at rest. Check --board, --squares and "
                "--dictionary, and that "
                "no projector shines on it");
  }
}

Footage read_take(const Arguments& arguments, const calibration::BoardDetector& detector) {
  take::TakeReader take(arguments.take);
  SetCollector collector(detector, arguments.save);
  Progress progress("Finding the board", static_cast<std::uint64_t>(take.frame_count()), "frames");
  std::int64_t with_pictures = 0;
  for (std::int64_t i = 0; i < take.frame_count() && collector.kept() < arguments.views; ++i) {
    const auto frame = take.frame(i);
    if (frame->images != nullptr && (with_pictures > 0 || calibration::has_all_pictures(*frame->images))) {
      ++with_pictures;
      collector.offer(*frame->images);
    }
    progress.set(static_cast<std::uint64_t>(i + 1),
                 fmt::format("{} views, {}", collector.kept(), coverage_text(collector)));
  }
  progress.finish();
  if (with_pictures == 0) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("'{}' has no pictures of all cameras: it must be a take of frame sets (mode \"frames\")",
                    arguments.take));
  }
  require_views(collector);
  return std::move(collector.footage());
}

const char* advice(calibration::ViewPicker::Verdict verdict) {
  using Verdict = calibration::ViewPicker::Verdict;
  switch (verdict) {
    case Verdict::Kept:
      return "kept; move on";
    case Verdict::NoBoard:
      return "no board is seen";
    case Verdict::Moving:
      return "hold it still";
    case Verdict::SeenBefore:
      return "move or tilt it";
  }
  return "";
}

Footage watch_daemon(const Arguments& arguments, const calibration::BoardDetector& detector) {
  const StopSignals signals;
  stream::Subscription subscription;
  subscription.profile = stream::Profile::Signals;
  subscription.client = "facet calibrate";
  subscription.want_images = true;
  stream::StreamClient client(arguments.stream->path(), subscription);
  SetCollector collector(detector, arguments.save);
  Progress progress("Taking views", arguments.views, "views");
  stream::DecodedFrame got;
  bool begun = false;
  while (collector.kept() < arguments.views && signals.pending() == 0) {
    const stream::ReceiveOutcome outcome = client.next(got, 200ms);
    if (outcome == stream::ReceiveOutcome::Closed) {
      throw Error(ErrorKind::Unavailable,
                  fmt::format("the stream ended after {} of {} views: {}", collector.kept(), arguments.views,
                              client.closed_reason()));
    }
    if (outcome == stream::ReceiveOutcome::Timeout) {
      continue;
    }
    if (got.frame.images == nullptr) {
      throw Error(ErrorKind::Unavailable,
                  "facetd sends no pictures: it must run in mode \"frames\" (config/devices.toml)");
    }
    if (begun || calibration::has_all_pictures(*got.frame.images)) {
      begun = true;
      const auto verdict = collector.offer(*got.frame.images);
      progress.set(collector.kept(), fmt::format("{}, {}", coverage_text(collector), advice(verdict)));
    } else {
      progress.set(0, "not all cameras send pictures (`facet status`)");
    }
  }
  progress.finish();
  require_views(collector);
  return std::move(collector.footage());
}

/// The pictures that are left out, gathered by camera and reason.
void print_rejected(const std::vector<calibration::RejectedPicture>& rejected) {
  std::map<std::pair<std::string, std::string>, std::vector<const calibration::RejectedPicture*>> groups;
  for (const calibration::RejectedPicture& one : rejected) {
    groups[{one.camera, one.reason.substr(0, one.reason.find(':'))}].push_back(&one);
  }
  for (const auto& [key, members] : groups) {
    constexpr std::size_t kNamed = 4;
    std::vector<std::string> names;
    for (std::size_t i = 0; i < std::min(members.size(), kNamed); ++i) {
      names.push_back(members[i]->view);
    }
    tell("left out, camera '{}': {} ({} picture{}: {}{})\n", key.first,
         members.size() == 1 ? members[0]->reason : key.second, members.size(),
         members.size() == 1 ? "" : "s", fmt::format("{}", fmt::join(names, ", ")),
         members.size() > kNamed ? " ..." : "");
  }
}

void print_report(const calibration::Calibration& found, const std::vector<calibration::Coverage>& coverage) {
  tell("\n{:<16}{:>6}{:>9}{:>15}{:>21}{:>19}{:>10}\n", "camera", "views", "corners", "reprojection",
       "focal length px", "principal point", "covered");
  for (std::size_t i = 0; i < found.cameras.size(); ++i) {
    const calibration::CameraReport& camera = found.cameras[i];
    const capture::Lens& lens = found.rig.cameras[i].lens;
    tell("{:<16}{:>6}{:>9}{:>12.3f} px{:>13.2f} +- {:.2f}{:>11.2f} {:7.2f}{:>8.0f} %\n", camera.name,
         camera.views, camera.corners, camera.rms_px, 0.5 * (lens.fx_px + lens.fy_px), camera.sigma[0],
         lens.cx_px, lens.cy_px, 100 * coverage[i].part());
  }
  if (!found.pairs.empty()) {
    tell("\n{:<32}{:>9}{:>15}{:>15}{:>8}\n", "pair", "corners", "epipolar", "baseline", "angle");
  }
  for (const calibration::PairReport& pair : found.pairs) {
    tell("{:<32}{:>9}{:>12.3f} px{:>12.3f} mm{:>7.1f}°\n",
         found.cameras[pair.pair.left].name + " | " + found.cameras[pair.pair.right].name, pair.corners,
         pair.epipolar_rms_px, pair.baseline_mm, pair.angle_deg);
  }
  tell("\n{} views, reprojection error {:.3f} px (rms)\n", found.views, found.rms_px);
}

/// What is not wrong but could be better.
void print_warnings(const calibration::Calibration& found,
                    const std::vector<calibration::Coverage>& coverage) {
  constexpr double kLeastCovered = 0.6;
  constexpr double kMostFocalSigma = 1e-3;
  constexpr double kMostRms_px = 0.5;
  for (std::size_t i = 0; i < found.cameras.size(); ++i) {
    const calibration::CameraReport& camera = found.cameras[i];
    if (coverage[i].part() < kLeastCovered) {
      tell(
          "warning: camera '{}': corners in {:.0f} % of the picture only: the distortion elsewhere is a "
          "guess. "
          "Bring the board to its edges and corners\n",
          camera.name, 100 * coverage[i].part());
    }
    if (camera.sigma[0] > kMostFocalSigma * found.rig.cameras[i].lens.fx_px) {
      tell(
          "warning: camera '{}': the focal length is uncertain by {:.2f} %: tilt the board more (at most "
          "{:.0f} "
          "degrees between views so far), and take more views\n",
          camera.name, 100 * camera.sigma[0] / found.rig.cameras[i].lens.fx_px, camera.largest_tilt_deg);
    }
    if (camera.rms_px > kMostRms_px) {
      tell(
          "warning: camera '{}': a reprojection error of {:.2f} px is large: is the board flat and its "
          "square "
          "size right? Wide lenses need --k3\n",
          camera.name, camera.rms_px);
    }
  }
}

void finish(const Arguments& arguments, const Board& board, Footage footage) {
  calibration::CalibratorOptions options = arguments.calibrator;
  for (const std::string& given : arguments.pairs) {
    const std::size_t colon = given.find(':');
    if (colon == std::string::npos || colon == 0 || colon + 1 == given.size()) {
      throw Error(ErrorKind::Usage, fmt::format("--pair {}: must be LEFT:RIGHT", given));
    }
    options.pairs.emplace_back(given.substr(0, colon), given.substr(colon + 1));
  }
  for (const std::string& name : arguments.colour) {
    const auto at =
        std::find_if(footage.cameras.begin(), footage.cameras.end(),
                     [&](const calibration::CalibrationCamera& camera) { return camera.name == name; });
    if (at == footage.cameras.end()) {
      throw Error(ErrorKind::Usage, fmt::format("--colour {}: there is no such camera", name));
    }
    at->colour = true;
  }
  std::vector<calibration::Coverage> coverage;
  std::vector<std::string> names;
  for (std::size_t i = 0; i < footage.cameras.size(); ++i) {
    names.push_back(footage.cameras[i].name);
    coverage.emplace_back(std::max(footage.cameras[i].width_px, 1),
                          std::max(footage.cameras[i].height_px, 1));
    for (const calibration::CalibrationView& view : footage.views) {
      if (view.seen[i].usable()) {
        coverage.back().add(view.seen[i]);
      }
    }
  }
  const std::filesystem::path output = arguments.output;
  const auto beside = [&](const char* what) {
    return output.parent_path() / fmt::format("{}-{}.png", output.stem().string(), what);
  };
  // Before the calibration, which may fail for what this picture shows.
  render::write_png(calibration::coverage_picture(names, coverage), beside("coverage"));
  tell("{}: where corners were seen\n", beside("coverage").string());
  calibration::Calibration found;
  {
    Progress progress("Calibrating", footage.cameras.size() + 1, "steps");
    found = calibration::calibrate(
        board, footage.cameras, footage.views, options,
        [&](const std::string& what, std::size_t done, std::size_t) { progress.set(done, what); });
  }
  print_rejected(found.rejected);
  print_report(found, coverage);
  print_warnings(found, coverage);
  render::write_png(calibration::error_picture(found, calibration::fitting_exaggeration(found)),
                    beside("errors"));
  tell("{}: what remains at every corner\n", beside("errors").string());
  capture::write_rig(found.rig, output);
  tell("{}: {} camera{}, {} pair{}\n", output.string(), found.rig.cameras.size(),
       found.rig.cameras.size() == 1 ? "" : "s", found.rig.pairs.size(),
       found.rig.pairs.size() == 1 ? "" : "s");
}

void add_board_options(Command command, BoardArguments& board) {
  command.option("--board", board.kind, "charuco: may be partly hidden; checkerboard: must be seen whole")
      .shows_default()
      .one_of({"charuco", "checkerboard"});
  command.option("--squares", board.squares, "COLUMNSxROWS, squares (not inner corners)").shows_default();
  command.option("--square-mm", board.square_mm, "Side of a square, measured on the printed board")
      .shows_default();
  command.option("--marker-mm", board.marker_mm, "Side of a ChArUco marker; 0: three quarters of the square")
      .shows_default();
  command.option("--dictionary", board.dictionary, "Of the ChArUco markers, as OpenCV names it without DICT_")
      .shows_default();
}

void add_calibration_options(Command command, Arguments& arguments) {
  add_board_options(command, arguments.board);
  command
      .option("-o,--output", arguments.output,
              "Rig file to write (.toml); NAME-coverage.png and NAME-errors.png come to stand beside it")
      .required();
  command.option("--pair", arguments.pairs,
                 "LEFT:RIGHT, cameras that make a depth map; again for more. Default: monochrome neighbours");
  command.option("--colour", arguments.colour,
                 "A camera that counts as one of colour; default: whose pictures are");
  command.flag("--k3", arguments.calibrator.free_k3, "Fit a third radial coefficient (wide lenses)");
  command.option("--min-views", arguments.calibrator.least_views, "Views that each camera needs")
      .shows_default()
      .range(3, 1000);
  command.option("--min-corners", arguments.detector.least_corners, "Pictures with fewer are left out")
      .shows_default()
      .range(6, 4000);
  command
      .option("--max-edge-px", arguments.detector.most_edge_width_px,
              "Pictures whose edges are wider (blurred) are left out")
      .shows_default()
      .range(1.0, 100.0);
  command
      .option("--max-oblique-deg", arguments.calibrator.most_oblique_deg,
              "Boards seen at a larger angle are left out")
      .shows_default()
      .range(5.0, 89.0);
  command
      .option("--max-error-px", arguments.calibrator.most_error_px,
              "Pictures with a larger reprojection error, and three times that of the others, are left out")
      .shows_default()
      .range(0.01, 100.0);
}

void add_board(Command parent) {
  struct Sheet {
    BoardArguments board;
    std::string output;
    double px_per_mm = 10;
  };
  auto sheet = std::make_shared<Sheet>();
  const Command command = parent.subcommand("board", "Draw the board to print");
  add_board_options(command, sheet->board);
  command.option("-o,--output", sheet->output, "File to write: .pdf (true size) or .png").required();
  command.option("--px-per-mm", sheet->px_per_mm, "Of a PNG").shows_default().range(0.1, 100.0);
  command.callback([sheet] {
    const Board board = board_of(sheet->board);
    const std::filesystem::path file = sheet->output;
    if (file.extension() == ".pdf") {
      files::OutputFile out(file);
      out.write(calibration::board_pdf(board));
      out.commit();
    } else if (file.extension() == ".png") {
      render::write_png(calibration::draw_board(board, sheet->px_per_mm), file);
    } else {
      throw Error(ErrorKind::Usage, fmt::format("-o {}: the name must end in .pdf or .png", sheet->output));
    }
    const double margin = calibration::margin_mm(board);
    tell(
        "{}: {:g} x {:g} mm with its margin. Print it at 100 %, glue it on something flat, measure a "
        "square\n",
        file.string(), board.columns * board.square_mm + 2 * margin,
        board.rows * board.square_mm + 2 * margin);
  });
}

}  // namespace

void add_calibrate_command(Command app) {
  const Command command =
      app.subcommand("calibrate", "Calibrate cameras with a board: from pictures to a rig file");
  command.requires_subcommand();
  command.footer(
      "1. `facet calibrate board -o board.pdf`; print it at its true size and glue it on something flat.\n"
      "2. Show it to the cameras, 30 views and more: near and far, at all edges, tilted by 20 to 45 degrees "
      "to all\n"
      "sides, often enough to neighbouring cameras at once, held still, projectors off.\n"
      "3. `facet calibrate live`, `take` or `pictures` with the board's size. Docs: calibration.md.");
  add_board(command);

  auto pictures = std::make_shared<Arguments>();
  const Command from_pictures =
      command.subcommand("pictures", "Calibrate from folders of pictures, one a camera");
  from_pictures
      .option("folders", pictures->folders,
              "CAMERA=FOLDER for each camera; pictures of one name (.png, .jpg) were taken at once")
      .required();
  add_calibration_options(from_pictures, *pictures);
  from_pictures.callback([pictures] {
    const Board board = board_of(pictures->board);
    const calibration::BoardDetector detector(board, pictures->detector);
    finish(*pictures, board, read_folders(*pictures, detector));
  });

  auto take = std::make_shared<Arguments>();
  const Command from_take = command.subcommand("take", "Calibrate from a take of frame sets");
  from_take.option("take", take->take, "Take recorded in mode \"frames\", projectors off").required();
  add_calibration_options(from_take, *take);
  from_take.option("--views", take->views, "Views to choose from it at most").shows_default().range(3, 1000);
  from_take.option("--save", take->save, "Write the pictures of the chosen views into FOLDER/CAMERA/");
  from_take.callback([take] {
    const Board board = board_of(take->board);
    const calibration::BoardDetector detector(board, take->detector);
    finish(*take, board, read_take(*take, detector));
  });

  auto live = std::make_shared<Arguments>();
  const Command from_daemon = command.subcommand("live", "Calibrate with the cameras of a running facetd");
  live->stream = add_stream_options(from_daemon, "Stream socket");
  add_calibration_options(from_daemon, *live);
  from_daemon.option("--views", live->views, "Views to take; Ctrl-C goes on with those that are there")
      .shows_default()
      .range(3, 1000);
  from_daemon.option("--save", live->save,
                     "Write the pictures of the views into FOLDER/CAMERA/, for `facet calibrate pictures`");
  from_daemon.callback([live] {
    const Board board = board_of(live->board);
    const calibration::BoardDetector detector(board, live->detector);
    finish(*live, board, watch_daemon(*live, detector));
  });
}

}  // namespace facet::tools
