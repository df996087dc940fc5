// `facet pose`: a face of a take posed by control points.

#include <fmt/format.h>

#include <array>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "animate/face_ik.hpp"
#include "animate/places.hpp"
#include "animate_options.hpp"
#include "exports/formats.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"
#include "report/take_pictures.hpp"
#include "stop_signals.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

constexpr int kPictureWidth_px = 720;
constexpr int kPictureHeight_px = 864;

struct PoseOptions {
  BasisChoice basis;
  std::vector<std::string> at;
  std::vector<std::string> move;
  std::vector<std::string> screen;
  bool whole = false;
  bool beyond = false;
  bool average_folds = false;
  bool places = false;
  std::string output;
};

struct Control {
  animate::ControlTarget target;
  std::string name;
};

/// "VERTEX=1,2,3".
Control parse_control(const animate::TakeBasis& basis, const std::string& option, const std::string& text,
                      bool on_screen) {
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} {}: give it as VERTEX={}", option, text, on_screen ? "X,Y" : "X,Y,Z"));
  }
  Control control;
  control.name = text.substr(0, equals);
  control.target.vertex = animate::find_vertex(basis, control.name);
  control.target.space =
      on_screen ? animate::ControlTarget::Space::Screen : animate::ControlTarget::Space::Head;
  const auto numbers =
      parse_numbers(fmt::format("{} {}", option, control.name), text.substr(equals + 1), on_screen ? 2 : 3);
  for (std::size_t axis = 0; axis < numbers.size(); ++axis) {
    control.target.target[static_cast<Eigen::Index>(axis)] = numbers[axis];
  }
  return control;
}

/// The mean face, posed.
mesh::Vertices resting_vertices(animate::FaceIk& ik) {
  animate::Pose pose;
  ik.solve({}, pose);
  mesh::MeshFrame frame;
  animate::blend(ik.basis(), pose, frame);
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(ik.basis().hierarchy(), frame.control_vertices_mm, frame.displacements_mm, vertices,
                       normals);
  return vertices;
}

void print_places(const animate::TakeBasis& basis, const mesh::Vertices& resting_mm) {
  for (const auto& [name, vertex] : animate::places(basis)) {
    const Eigen::Vector3f at = resting_mm.col(vertex);
    tell("{:<12} vertex {:<6} rests at {:.1f},{:.1f},{:.1f}\n", name, vertex, at.x(), at.y(), at.z());
  }
}

void report(const std::vector<Control>& controls, const std::vector<animate::ControlOutcome>& outcomes,
            const animate::TakeBasis& basis) {
  for (std::size_t i = 0; i < controls.size(); ++i) {
    const char* unit = controls[i].target.space == animate::ControlTarget::Space::Screen ? "px" : "mm";
    const animate::ControlOutcome& outcome = outcomes[i];
    tell("{}: {:.3f} {} from its target; the region is {:.2f} mm (rms) from frame {}", controls[i].name,
         outcome.miss, unit, outcome.nearest_mm,
         basis.frames()[static_cast<std::size_t>(outcome.nearest_frame)].sequence);
    if (outcome.clamped) {
      tell("; pulled back, the target was {:.1f} {} outside what was captured", outcome.outside, unit);
    } else if (outcome.outside > animate::kOutsideTolerance) {
      tell("; {:.1f} {} outside what was captured", outcome.outside, unit);
    }
    tell("\n");
    if (!outcome.met) {
      tell(stderr,
           "facet pose: {} can't be met: the take does not move it so, or other control points hold it\n",
           controls[i].name);
    }
    if (outcome.nearest_mm > animate::kFarFromCaptured_mm) {
      tell(stderr,
           "facet pose: warning: the region of {} is {:.1f} mm (rms) from the nearest captured face: it may "
           "be "
           "no face of this person. Look at it (-o pose.png); drag less far, or fewer points\n",
           controls[i].name, outcome.nearest_mm);
    }
  }
}

/// The face, and beside it its regions in colours.
void write_picture(const animate::Pose& pose, const mesh::MeshFrame& frame, const std::string& file) {
  constexpr std::array<std::array<float, 3>, 6> kHues{{{0.9F, 0.25F, 0.15F},
                                                       {0.1F, 0.55F, 0.85F},
                                                       {0.2F, 0.7F, 0.2F},
                                                       {0.85F, 0.65F, 0.1F},
                                                       {0.6F, 0.2F, 0.75F},
                                                       {0.1F, 0.7F, 0.65F}}};
  const animate::RegionWeights& regions = pose.maps->finest();
  mesh::Vertices tints(3, static_cast<Eigen::Index>(regions.offsets.size()) - 1);
  for (Eigen::Index v = 0; v < tints.cols(); ++v) {
    Eigen::Vector3f hue = Eigen::Vector3f::Zero();
    const auto row = static_cast<std::size_t>(v);
    for (std::int32_t k = regions.offsets[row]; k < regions.offsets[row + 1]; ++k) {
      const auto entry = static_cast<std::size_t>(k);
      hue += regions.weights[entry] *
             Eigen::Map<const Eigen::Vector3f>(kHues[regions.regions[entry] % kHues.size()].data());
    }
    tints.col(v) = 1.6F * hue;
  }
  render::Picture picture = render::plain_picture(2 * kPictureWidth_px, kPictureHeight_px, report::kPaper);
  const CameraIntrinsics camera =
      report::cell_around(report::face_vertices(frame), frame.camera, kPictureWidth_px, kPictureHeight_px)
          .camera;
  render::paste(picture, draw_face(frame, camera), 0, 0);
  render::paste(picture, draw_face(frame, camera, tints), kPictureWidth_px, 0);
  render::write_png(picture, file);
}

void run_pose(const PoseOptions& options) {
  const StopSignals signals;
  const auto basis = open_basis(options.basis, signals);
  animate::IkOptions ik_options;
  ik_options.whole = options.whole;
  ik_options.beyond = options.beyond;
  ik_options.sharp_folds = !options.average_folds;
  animate::FaceIk ik(basis, ik_options);
  ik.set_view(basis->sample().camera, basis->sample().camera_from_head);
  const mesh::Vertices resting_mm = resting_vertices(ik);
  if (options.places) {
    print_places(*basis, resting_mm);
  }
  if (options.output.empty()) {
    if (!options.places) {
      throw Error(ErrorKind::Usage, "give -o FILE, or --places for the names of vertices");
    }
    return;
  }
  std::vector<Control> controls;
  for (const std::string& text : options.at) {
    controls.push_back(parse_control(*basis, "--control", text, false));
  }
  for (const std::string& text : options.move) {
    controls.push_back(parse_control(*basis, "--move", text, false));
    animate::ControlTarget& target = controls.back().target;
    const std::int32_t one[] = {target.vertex};
    animate::check_controls(*basis, one);
    target.target += resting_mm.col(target.vertex);
  }
  for (const std::string& text : options.screen) {
    controls.push_back(parse_control(*basis, "--screen", text, true));
  }
  std::vector<animate::ControlTarget> targets;
  targets.reserve(controls.size());
  for (const Control& control : controls) {
    targets.push_back(control.target);
  }
  animate::Pose pose;
  report(controls, ik.solve(targets, pose), *basis);
  mesh::MeshFrame frame = animate::blank_frame(*basis);
  animate::blend(*basis, pose, frame);
  end_where_broken_off(signals, options.output);

  const std::string extension = std::filesystem::path(options.output).extension();
  if (extension == ".png") {
    write_picture(pose, frame, options.output);
  } else {
    exports::ExportMesh mesh;
    exports::build_export_mesh(frame, exports::MeshLevel::Finest, exports::MeshSpace::Camera, mesh);
    exports::mesh_writer_for(options.output)(mesh, options.output, exports::MeshAxes::Upright);
  }
  tell("{}\n", options.output);
}

}  // namespace

void add_pose_command(Command app) {
  auto options = std::make_shared<PoseOptions>();
  const Command command = app.subcommand("pose", "Pose a take's face by dragging points of it (FaceIK)");
  add_basis_options(command, options->basis);
  command
      .option(
          "--control", options->at,
          "VERTEX=X,Y,Z: where a vertex of the finest mesh, a number or a place, shall be; head frame, mm "
          "(x to the subject's left, y up, z forward)")
      .one_at_a_time();
  command.option("--move", options->move, "VERTEX=DX,DY,DZ: the same from where it rests, mm")
      .one_at_a_time();
  command.option("--screen", options->screen, "VERTEX=X,Y: where it shall be in the camera's picture, px")
      .one_at_a_time();
  command.flag("--whole", options->whole, "Without regions: all points act on the whole face at once");
  command.flag("--beyond", options->beyond,
               "Let points go beyond what was captured; without, they are pulled back to the nearest place "
               "where the take had them");
  command.flag("--average-folds", options->average_folds,
               "Average wrinkles as everything else, for comparison");
  command.flag("--places", options->places, "Print the vertices that have names, and where they rest");
  command
      .option("-o,--output", options->output,
              "pose.glb, .ply or .obj: the mesh as of `facet export`; .png: a picture with its regions "
              "in colours")
      .ends_in({".glb", ".ply", ".obj", ".png"});
  command.callback([options] { run_pose(*options); });
}

}  // namespace facet::tools
