// `facet scan`: from folders of structured-light pictures to a surface.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <iterator>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/code_sequence.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/pfm.hpp"
#include "maths/statistics.hpp"
#include "natural_order.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"
#include "report/depth_pictures.hpp"
#include "scan/structured_light.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct ScanOptions {
  std::string rig;
  std::string left;
  std::string right;
  std::string projector;
  std::string sequence;
  std::string response = "auto";
  std::vector<float> depths;
  std::string output;
  bool explain = false;
  scan::DecodeOptions decode;
  scan::StructuredLightOptions match;
};

/// A camera of the rig and its pictures, in the sequence's order.
struct Footage {
  std::size_t camera = 0;
  std::vector<std::filesystem::path> files;
};

std::vector<std::filesystem::path> pictures_in(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    // The last three are refused by name, with what to do about them.
    constexpr std::array kPictures = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"};
    if (std::find(kPictures.begin(), kPictures.end(), extension) != kPictures.end()) {
      files.push_back(entry.path());
    }
  }
  if (error) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}': cannot read this folder: {}", folder.string(), error.message()));
  }
  std::sort(files.begin(), files.end(), [](const auto& a, const auto& b) {
    return natural_before(a.filename().string(), b.filename().string());
  });
  return files;
}

std::size_t camera_named(const capture::Rig& rig, const std::string& name, const std::string& rig_file) {
  const auto found = capture::find_camera(rig, name);
  if (!found) {
    throw Error(ErrorKind::Usage, fmt::format("{}: there is no camera '{}'", rig_file, name));
  }
  return *found;
}

/// "FOLDER" or "CAMERA=FOLDER".
Footage footage_of(const ScanOptions& options, const capture::Rig& rig, const std::string& given,
                   std::optional<std::size_t> usual, const capture::CodeSequence& sequence,
                   const char* option) {
  Footage out;
  std::string folder = given;
  const std::size_t equals = given.find('=');
  if (equals != std::string::npos && !std::filesystem::exists(given)) {
    out.camera = camera_named(rig, given.substr(0, equals), options.rig);
    folder = given.substr(equals + 1);
  } else if (usual) {
    out.camera = *usual;
  } else {
    throw Error(ErrorKind::Usage,
                fmt::format("{} {}: {} has no [[pair]]; say which camera it is: {} CAMERA=FOLDER", option,
                            given, options.rig, option));
  }
  out.files = pictures_in(folder);
  if (out.files.size() != sequence.pictures.size()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("'{}': has {} pictures{}, the sequence {}", folder, out.files.size(),
                    out.files.empty() ? std::string()
                                      : fmt::format(" ({} to {})", out.files.front().filename().string(),
                                                    out.files.back().filename().string()),
                    sequence.pictures.size()));
  }
  return out;
}

void explain(const Footage& footage, const capture::Rig& rig, const capture::CodeSequence& sequence) {
  tell("camera '{}':\n", rig.cameras[footage.camera].name);
  for (std::size_t picture = 0; picture < footage.files.size(); ++picture) {
    tell("  {:<28} {}\n", capture::name_of(sequence, picture), footage.files[picture].string());
  }
}

/// The response under which the camera's sines are sines.
scan::DecodedView decode(const Footage& footage, const capture::Rig& rig,
                         const capture::CodeSequence& sequence, ScanOptions& options, Progress& progress) {
  const capture::RigCamera& camera = rig.cameras[footage.camera];
  std::vector<scan::Response> responses;
  if (options.response != "srgb") {
    responses.push_back(scan::Response::Linear);
  }
  if (options.response != "linear") {
    responses.push_back(scan::Response::Srgb);
  }
  std::vector<scan::PhaseDecoder> decoders;
  for (const scan::Response response : responses) {
    scan::DecodeOptions decode_options = options.decode;
    decode_options.response = response;
    decoders.emplace_back(sequence, camera.lens.width_px, camera.lens.height_px, decode_options);
  }
  for (std::size_t picture = 0; picture < footage.files.size(); ++picture) {
    const std::filesystem::path& file = footage.files[picture];
    const render::GreyPicture grey = render::read_grey(file);
    if (grey.width_px != camera.lens.width_px || grey.height_px != camera.lens.height_px) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("{}: has {}x{} px, camera '{}' of {} has {}x{}", file.string(), grey.width_px,
                      grey.height_px, camera.name, options.rig, camera.lens.width_px, camera.lens.height_px));
    }
    for (scan::PhaseDecoder& decoder : decoders) {
      decoder.add(picture, grey.values);
    }
    progress.advance();
  }
  scan::DecodedView best = decoders.front().decode();
  std::size_t chosen = 0;
  if (decoders.size() > 1) {
    scan::DecodedView other = decoders.back().decode();
    if (other.residual < best.residual) {
      best = std::move(other);
      chosen = 1;
    }
  }
  options.response = responses[chosen] == scan::Response::Srgb ? "srgb" : "linear";
  return best;
}

void report(const scan::DecodedView& view, const std::string& camera, const std::string& folder) {
  tell("camera '{}':", camera);
  const char* comma = "";
  for (std::size_t fault = 0; fault < scan::kPhaseFaults; ++fault) {
    if (view.faults[fault] > 0) {
      tell("{} {:.1f} % {}", comma,
           100 * static_cast<double>(view.faults[fault]) / static_cast<double>(view.fault.size()),
           scan::to_string(static_cast<scan::PhaseFault>(fault)));
      comma = ",";
    }
  }
  tell("; {:.1f} % of the fringes' modulation is no sine\n", 100 * static_cast<double>(view.residual));
  for (const scan::PhaseField* field : {&view.columns, &view.rows}) {
    if (!field->why_no_phases.empty()) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("camera '{}' ({}): {} `--explain` shows what each file is taken for", camera,
                              folder, field->why_no_phases));
    }
  }
  if (view.faults[static_cast<std::size_t>(scan::PhaseFault::None)] == 0) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format(
            "camera '{}' ({}): no pixel could be decoded. `--explain` shows what each file is taken for",
            camera, folder));
  }
}

/// Linear grey of the left camera's pictures at the map's pixels.
std::vector<float> grey_of(const capture::DepthMap& map, const capture::Lens& camera,
                           const scan::DecodedView& view) {
  const Eigen::Isometry3d rig_from_map = map.lens.camera_from_rig.inverse();
  float brightest = 1e-6F;
  for (std::size_t at = 0; at < view.light.size(); ++at) {
    brightest = view.fault[at] == scan::PhaseFault::None ? std::max(brightest, view.light[at]) : brightest;
  }
  std::vector<float> grey(map.depth_mm.size(), 0.0F);
  for (int y = 0; y < map.height_px; ++y) {
    for (int x = 0; x < map.width_px; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(map.width_px) + static_cast<std::size_t>(x);
      const Eigen::Vector3d ray((x - map.lens.cx_px) / map.lens.fx_px, (y - map.lens.cy_px) / map.lens.fy_px,
                                1);
      const auto pixel = camera.project(rig_from_map * ray);
      if (pixel && pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() <= camera.width_px - 1 &&
          pixel->y() <= camera.height_px - 1) {
        const auto there =
            static_cast<std::size_t>(std::lround(pixel->y())) * static_cast<std::size_t>(camera.width_px) +
            static_cast<std::size_t>(std::lround(pixel->x()));
        grey[at] = view.light[there] / brightest;
      }
    }
  }
  return grey;
}

void write(const scan::StructuredDepth& depth, const capture::Lens& camera, const scan::DecodedView& view,
           const ScanOptions& options) {
  const capture::DepthMap& map = depth.map;
  const std::filesystem::path ply = options.output;
  const auto beside = [&](const char* extension) {
    std::filesystem::path file = ply;
    return file.replace_extension(extension);
  };
  const std::size_t points =
      report::write_depth_ply(map, grey_of(map, camera, view), options.match.break_mm, ply);
  render::write_png(report::relief_of(map), beside(".png"));
  files::write_pfm({map.width_px, map.height_px, map.depth_mm}, beside(".pfm"));
  capture::Rig lens_of_map;
  lens_of_map.cameras.push_back({"depth", map.lens, false});
  capture::write_rig(lens_of_map, beside(".toml"));
  std::vector<float> sigmas;
  std::copy_if(map.sigma_mm.begin(), map.sigma_mm.end(), std::back_inserter(sigmas),
               [](float sigma) { return sigma > 0; });
  if (sigmas.empty()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("no point has a depth from {:.0f} to {:.0f} mm: check the rig file, that left and "
                    "right are not exchanged, and --depths",
                    options.match.depths.nearest_mm, options.match.depths.farthest_mm));
  }
  tell("{}: {} points, standard deviation {:.3f} mm (median)", options.output, points,
       maths::median_of(sigmas));
  if (depth.ambiguous > 0) {
    tell("; {} px left out with more than one match", depth.ambiguous);
  }
  if (depth.epipolar_count > 0) {
    tell("; epipolar error {:.2f} px", depth.epipolar_px);
  }
  tell("\n");
  constexpr float kMostEpipolar_px = 1;
  if (depth.epipolar_px > kMostEpipolar_px) {
    tell(stderr,
         "facet: the epipolar error is above {:g} px: the calibration in {} does not fit these pictures\n",
         kMostEpipolar_px, options.rig);
  }
}

void run_scan(ScanOptions options) {
  const capture::Rig rig = capture::read_rig(options.rig);
  const capture::CodeSequence sequence = capture::parse_sequence(options.sequence);
  std::optional<std::size_t> first;
  if (!rig.pairs.empty()) {
    first = rig.pairs.front().left;
  } else if (rig.cameras.size() == 1) {
    first = 0;
  }
  const Footage left = footage_of(options, rig, options.left, first, sequence, "--left");
  std::optional<Footage> right;
  std::optional<std::size_t> projector;
  if (!options.right.empty()) {
    const auto usual = std::find_if(rig.pairs.begin(), rig.pairs.end(), [&](const capture::StereoPair& pair) {
      return pair.left == left.camera;
    });
    right = footage_of(options, rig, options.right,
                       usual == rig.pairs.end() ? std::nullopt : std::optional(usual->right), sequence,
                       "--right");
  } else {
    const auto named =
        std::find_if(rig.projectors.begin(), rig.projectors.end(),
                     [&](const capture::RigProjector& given) { return given.name == options.projector; });
    if (named == rig.projectors.end()) {
      throw Error(ErrorKind::Usage,
                  options.projector.empty()
                      ? std::string("give --right FOLDER or --projector NAME")
                      : fmt::format("{}: there is no projector '{}'", options.rig, options.projector));
    }
    projector = static_cast<std::size_t>(named - rig.projectors.begin());
  }
  if (options.explain) {
    explain(left, rig, sequence);
    if (right) {
      explain(*right, rig, sequence);
    }
    return;
  }
  Progress progress("Decoding", left.files.size() + (right ? right->files.size() : 0), "pictures");
  const scan::DecodedView left_view = decode(left, rig, sequence, options, progress);
  std::optional<scan::DecodedView> right_view;
  if (right) {
    right_view = decode(*right, rig, sequence, options, progress);
  }
  progress.finish();
  const auto folder_of = [](const Footage& footage) { return footage.files.front().parent_path().string(); };
  tell("response of the cameras: {}\n", options.response);
  report(left_view, rig.cameras[left.camera].name, folder_of(left));
  if (right) {
    report(*right_view, rig.cameras[right->camera].name, folder_of(*right));
  }
  const capture::StereoPair pair{left.camera, right ? right->camera : 0};
  if (!options.depths.empty()) {
    options.match.depths = {options.depths[0], options.depths[1]};
  } else {
    options.match.depths = right ? scan::find_depths(rig, pair, left_view, *right_view)
                                 : scan::find_depths(rig, left.camera, *projector, left_view);
    tell("depths: {:.0f} to {:.0f} mm (--depths)\n", options.match.depths.nearest_mm,
         options.match.depths.farthest_mm);
  }
  const scan::StructuredDepth depth =
      right ? scan::match_phases(rig, pair, left_view, *right_view, options.match)
            : scan::triangulate_phases(rig, left.camera, *projector, left_view, options.match);
  write(depth, rig.cameras[left.camera].lens, left_view, options);
}

}  // namespace

void add_scan_command(Command app) {
  auto options = std::make_shared<ScanOptions>();
  const Command command = app.subcommand(
      "scan", "From structured-light pictures of something still (phase shift) to its surface");
  command.option("--rig", options->rig, "Rig file (facet calibrate)").required();
  command
      .option("--left", options->left,
              "[CAMERA=]FOLDER of the left camera's pictures, one for each of the sequence, in the order "
              "of their names (2 before 10); without CAMERA the rig's first pair's")
      .required();
  command.option("--right", options->right, "The same of the right camera");
  command
      .option("--projector", options->projector,
              "Instead: depth from the left camera and this projector of the rig")
      .excludes("--right");
  command
      .option("--sequence", options->sequence,
              "What the pictures show, in their order, such as phase:4x64,gray:6,white,black. "
              "phase:NxF: N shifts of a sine of F periods (xF may be left out with Gray bits and two "
              "cameras); gray:M bits, most significant first (:fine-first: the other way); "
              "gray-inverse:M; gray-pairs:M: each bit and its inverse; white; black; skip:N; rows: what "
              "follows changes downwards; several phase groups: periods told by all of them")
      .required();
  command
      .option("-o,--output", options->output,
              "PLY to write; with it a shaded relief (.png), the depth map (.pfm) and its lens (.toml)")
      .required();
  command
      .option("--response", options->response,
              "Of the cameras: linear, srgb, or auto: under which the fringes are sines (4 shifts or more)")
      .shows_default()
      .one_of({"auto", "linear", "srgb"});
  command.option("--depths", options->depths, "Nearest and farthest, mm; else they are found")
      .expected(2)
      .positive();
  command.option("--smooth", options->decode.smooth_px, "Averages phases over (2 N + 1)^2 px")
      .shows_default()
      .range(0, 8);
  command
      .option("--modulation", options->decode.least_modulation,
              "Least amplitude of the fringes, white is 1; what has less is a hole")
      .shows_default();
  command.option("--sigma", options->match.most_sigma_mm, "Most standard deviation of a depth, mm")
      .shows_default();
  command.option("--break", options->match.break_mm, "Neighbours further apart in depth are not joined, mm")
      .shows_default();
  command.flag("--explain", options->explain, "Says what each file is taken for and ends");
  command.callback([options] { run_scan(*options); });
}

}  // namespace facet::tools
