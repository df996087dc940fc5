// `facet rig show` and `facet rig convert`: rig files, and those of OpenCV and Kalibr.

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <numbers>
#include <string>

#include "calibration/exchange.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct RigArguments {
  std::string input;
  std::string extrinsics;
  std::string size;
  calibration::OpenCvImport import;
  std::string output;
  std::string format = "rig";
  std::string pair;
};

capture::Rig read(RigArguments& arguments) {
  if (!arguments.size.empty()) {
    char end = 0;
    if (std::sscanf(arguments.size.c_str(), "%5dx%5d%c", &arguments.import.width_px,
                    &arguments.import.height_px, &end) != 2 ||
        arguments.import.width_px < 16 || arguments.import.height_px < 16) {
      throw Error(ErrorKind::Usage,
                  fmt::format("--size {}: must be WIDTHxHEIGHT in pixels, such as 640x480", arguments.size));
    }
  }
  return calibration::read_any_rig(arguments.input, arguments.extrinsics, arguments.import);
}

void show(const capture::Rig& rig) {
  constexpr double kDegrees = 180 / std::numbers::pi;
  tell("{:<16}{:>11}{:>20}{:>20}{:>24}   {}\n", "camera", "picture", "focal length px", "principal point",
       "place mm (x y z)", "distortion k1 k2 p1 p2 k3");
  const auto line = [&](const std::string& name, const capture::Lens& lens, const char* note) {
    const Eigen::Vector3d at = lens.centre_mm();
    const capture::LensDistortion& bent = lens.distortion;
    tell(
        "{:<16}{:>6}x{:<4}{:>10.2f} {:9.2f}{:>10.2f} {:9.2f}{:>8.1f} {:7.1f} {:7.1f}   {:.4f} {:.4f} {:.5f} "
        "{:.5f} "
        "{:.4f}{}\n",
        name, lens.width_px, lens.height_px, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, at.x(), at.y(),
        at.z(), bent.k1, bent.k2, bent.p1, bent.p2, bent.k3, note);
  };
  for (const capture::RigCamera& camera : rig.cameras) {
    line(camera.name, camera.lens, camera.colour ? "  colour" : "");
  }
  for (const capture::RigProjector& projector : rig.projectors) {
    line(projector.name, projector.lens, "  projector");
  }
  for (const capture::StereoPair& pair : rig.pairs) {
    const capture::Lens& left = rig.cameras[pair.left].lens;
    const capture::Lens& right = rig.cameras[pair.right].lens;
    const double cosine = left.camera_from_rig.linear().row(2).dot(right.camera_from_rig.linear().row(2));
    tell("pair {} | {}: baseline {:.3f} mm, {:.2f} degrees between the views\n", rig.cameras[pair.left].name,
         rig.cameras[pair.right].name, (left.centre_mm() - right.centre_mm()).norm(),
         std::acos(std::clamp(cosine, -1.0, 1.0)) * kDegrees);
  }
}

void write(const std::string& text, const std::filesystem::path& file) {
  files::OutputFile output(file);
  output.write(text);
  output.commit();
  tell("{}\n", file.string());
}

capture::StereoPair pair_of(const capture::Rig& rig, const std::string& text) {
  if (text.empty()) {
    if (rig.pairs.empty()) {
      throw Error(ErrorKind::Usage, "the rig has no pair: name two cameras (--pair LEFT:RIGHT)");
    }
    return rig.pairs.front();
  }
  const std::size_t colon = text.find(':');
  const auto index_of = [&](const std::string& name) {
    const auto at = capture::find_camera(rig, name);
    if (colon == std::string::npos || !at) {
      throw Error(ErrorKind::Usage,
                  fmt::format("--pair {}: must be LEFT:RIGHT, two of the rig's cameras", text));
    }
    return *at;
  };
  return {index_of(text.substr(0, colon)),
          index_of(colon == std::string::npos ? "" : text.substr(colon + 1))};
}

void convert(RigArguments& arguments) {
  const capture::Rig rig = read(arguments);
  const std::filesystem::path output = arguments.output;
  if (arguments.format == "rig") {
    capture::write_rig(rig, output);
    tell("{}\n", output.string());
  } else if (arguments.format == "kalibr") {
    write(calibration::format_kalibr(rig), output);
  } else {
    const calibration::OpenCvTexts texts = calibration::format_opencv(rig, pair_of(rig, arguments.pair));
    std::error_code ignored;  // OutputFile says what is wrong
    std::filesystem::create_directories(output, ignored);
    write(texts.intrinsics, output / "intrinsics.yml");
    write(texts.extrinsics, output / "extrinsics.yml");
  }
}

void add_input(Command command, RigArguments& arguments) {
  command.option("input", arguments.input, "Rig file (.toml), Kalibr camchain or OpenCV's intrinsics.yml")
      .required();
  command.option("--extrinsics", arguments.extrinsics,
                 "OpenCV's extrinsics.yml; default: R and T are in the same file");
  command.option("--size", arguments.size, "WIDTHxHEIGHT of the pictures, which OpenCV's files do not say");
  command.option("--unit-mm", arguments.import.unit_mm, "Unit of OpenCV's T in mm; 1000: metres")
      .shows_default()
      .range(1e-3, 1e6);
}

}  // namespace

void add_rig_command(Command app) {
  const Command command = app.subcommand("rig", "Show and convert rig files: calibrated cameras");
  command.requires_subcommand();

  auto shown = std::make_shared<RigArguments>();
  const Command show_command = command.subcommand("show", "Check a rig file and print its cameras and pairs");
  add_input(show_command, *shown);
  show_command.callback([shown] { show(read(*shown)); });

  auto converted = std::make_shared<RigArguments>();
  const Command convert_command =
      command.subcommand("convert", "Convert between rig files and those of OpenCV and Kalibr");
  add_input(convert_command, *converted);
  convert_command.option("-o,--output", converted->output, "File to write; for OpenCV a folder").required();
  convert_command.option("--to", converted->format, "What to write")
      .shows_default()
      .one_of({"rig", "opencv", "kalibr"});
  convert_command.option("--pair", converted->pair, "LEFT:RIGHT, the pair for OpenCV; default: the first");
  convert_command.callback([converted] { convert(*converted); });
}

}  // namespace facet::tools
