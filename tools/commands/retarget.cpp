// `facet retarget`: a take's performance on somebody else's avatar.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "avatar/retarget.hpp"
#include "avatar/skin.hpp"
#include "exports/export.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "stop_signals.hpp"
#include "take_frames.hpp"
#include "take_person.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct RetargetOptions {
  std::string take;
  std::string avatar;
  std::string frames;
  std::optional<std::uint64_t> neutral;
  std::string head;
  bool no_head = false;
  bool allow_missing = false;
  std::string displacement_maps;
  std::string normal_maps;
  std::string map_format = "exr";
  int size_px = 1024;
  std::string model;
  std::string output;
};

/// A weight that stays below this all the time is noise.
constexpr float kLeastMovement = 0.05F;

struct Performance {
  std::vector<avatar::FaceState> states;  ///< of the frames with a face
  std::vector<float> times_s;
  exports::Timeline timeline;
};

std::string shape_list(const std::vector<std::size_t>& shapes) {
  std::string text;
  for (const std::size_t shape : shapes) {
    text += (text.empty() ? "" : ", ") + mesh::arkit_name(shape);
  }
  return text;
}

std::string name_list(const std::vector<std::string>& names) {
  constexpr std::size_t kMostNamed = 80;
  std::string text;
  for (std::size_t i = 0; i < std::min(names.size(), kMostNamed); ++i) {
    text += (text.empty() ? "" : ", ") + names[i];
  }
  return text.empty() ? "none" : names.size() > kMostNamed ? text + " ..." : text;
}

/// The pose of the frame that counts as neutral.
avatar::NeutralPose neutral_of(take::TakeReader& reader, std::uint64_t sequence) {
  const auto index = frames_in_range(reader, fmt::format("{}:{}", sequence, sequence + 1)).front();
  const avatar::FaceState state = avatar::face_state(*reader.frame(index, take::Pictures::Described));
  if (!state.tracked) {
    throw Error(ErrorKind::NoFace, fmt::format("frame {} has no face: --neutral wants one", sequence));
  }
  return {state.values, state.upright_from_head};
}

/// Returns the signal that broke it off, or 0.
int read_performance(const RetargetOptions& options, const StopSignals& signals, Performance& performance) {
  take::TakeReader reader(options.take);
  std::optional<avatar::NeutralPose> neutral;
  if (options.neutral) {
    neutral = neutral_of(reader, *options.neutral);
  }
  std::vector<take::FrameEntry> entries;
  for (const std::int64_t index : frames_in_range(reader, options.frames)) {
    if (const take::FrameEntry entry = reader.entry(index); entry.has_mesh) {
      entries.push_back(entry);
    }
  }
  if (entries.empty()) {
    throw Error(ErrorKind::NoFace, "none of the selected frames has a face: nothing was written");
  }
  performance.timeline = exports::make_timeline(entries, options.take);
  Progress progress("Reading", entries.size());
  for (const take::FrameEntry& entry : entries) {
    if (const int signal = signals.pending(); signal != 0) {
      return signal;
    }
    avatar::FaceState state = avatar::face_state(*reader.frame(entry.index, take::Pictures::Described));
    if (!state.has_expression) {
      throw Error(ErrorKind::Usage,
                  fmt::format("{}: frame {} has no expressions (a booth's template fit has none)",
                              options.take, entry.sequence));
    }
    if (neutral) {
      avatar::subtract_values(*neutral, state);
      avatar::subtract_head(*neutral, state);
    }
    performance.states.push_back(state);
    performance.times_s.push_back(static_cast<float>(exports::time_s(performance.timeline, entry.sequence)));
    progress.advance();
  }
  return 0;
}

/// The shapes that the performance moves.
std::vector<std::size_t> moved_shapes(const std::vector<avatar::FaceState>& states) {
  std::vector<std::size_t> moved;
  for (std::size_t shape = 0; shape < mesh::kArkitNames.size(); ++shape) {
    if (std::any_of(states.begin(), states.end(), [shape](const avatar::FaceState& state) {
          return state.values.at(shape) > kLeastMovement;
        })) {
      moved.push_back(shape);
    }
  }
  return moved;
}

/// Throws Error(Usage) that names all that the avatar lacks.
void check_avatar(const RetargetOptions& options, const avatar::Avatar& found,
                  const std::vector<avatar::FaceState>& states) {
  std::vector<std::string> faults;
  if (!options.no_head && !found.head) {
    faults.push_back(
        fmt::format("'{}' has no node that is named like a head: name it with --head, or leave "
                    "the head still with --no-head",
                    options.avatar));
  }
  const std::vector<std::size_t> missing = avatar::missing_shapes(found, moved_shapes(states));
  if (!missing.empty() || found.meshes.empty()) {
    const std::string what = fmt::format(
        "'{}' lacks {} shapes that '{}' moves: {}; its morph targets (targetNames) are: {}", options.avatar,
        missing.size(), options.take, shape_list(missing), name_list(found.shape_names));
    if (options.allow_missing && !found.meshes.empty()) {
      tell(stderr, "note: {}\n", what);
    } else {
      faults.push_back(what + (found.meshes.empty() ? "" : "; --allow-missing goes on without them"));
    }
  }
  if (!faults.empty()) {
    throw Error(ErrorKind::Usage, fmt::format("{}", fmt::join(faults, "\n")));
  }
}

/// The take's face as an avatar's skin is placed on it. Shapes and surface are those of the coarse level.
avatar::PersonShapes shapes_of(const mesh::MeshFrame& frame, const face::ExpressionBasis& basis) {
  const mesh::Subject& subject = *frame.subject;
  const mesh::Level& coarse = subject.hierarchy->levels.front();
  avatar::PersonShapes person;
  mesh::apply(coarse.from_coarser, basis.neutral_mm, person.neutral_mm);
  person.triangles = coarse.triangles;
  for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
    if (const int shape = mesh::arkit_index(subject.expression_names[e]); shape >= 0) {
      mesh::Vertices delta_mm;
      mesh::apply(coarse.from_coarser, basis.deltas_mm[e], delta_mm);
      person.shapes.emplace_back(shape, std::move(delta_mm));
    }
  }
  std::vector<Eigen::Index> skin;
  for (std::size_t v = 0; v < subject.regions.size(); ++v) {
    if (face::has_region(subject.regions[v], face::Region::Refinable)) {
      skin.push_back(static_cast<Eigen::Index>(v));
    }
  }
  person.skin_mm = basis.neutral_mm(Eigen::all, skin);
  return person;
}

/// The avatar's skin on the take's face, as the maps are baked for it; tells how well it lies there.
std::shared_ptr<const exports::MapLayout> map_layout(const RetargetOptions& options,
                                                     const avatar::GlbDocument& glb,
                                                     const avatar::Avatar& found,
                                                     const mesh::MeshFrame& frame) {
  const face::ExpressionBasis basis = person_shapes(frame, options.take, options.model);
  const std::vector<avatar::Skin> skins = avatar::read_skins(glb, found);
  const auto [chosen, placement] = avatar::choose_skin(skins, shapes_of(frame, basis));
  const avatar::Skin& skin = skins[chosen];
  tell(
      "mesh '{}': on the face by {} shapes, {:.1f} mm apart (median), surfaces {:.1f} mm (rms), {:.0f} % of "
      "the face covered; 1 mm of the maps is {:.4g} of its units\n",
      skin.name, placement.shape_count, placement.shape_distance_mm, placement.surface_distance_mm,
      100 * placement.covered, 1 / placement.mm_per_unit);
  mesh::Vertices neutral_mm;
  Eigen::Matrix3Xf normals;
  const mesh::Hierarchy& hierarchy = *frame.subject->hierarchy;
  mesh::rebuild_finest(hierarchy, basis.neutral_mm, {}, neutral_mm, normals);
  const auto face = std::make_shared<avatar::FaceUnderSkin>(neutral_mm, hierarchy.finest().triangles);
  auto layout = std::make_shared<exports::MapLayout>();
  layout->triangles = skin.triangles;
  layout->texture_coordinates = skin.texture_coordinates;
  layout->vertices_mm = placement.to_head_mm(skin.vertices);
  layout->normals = placement.head_from_skin * skin.normals;
  // The layout owns the function: it must not own the layout.
  const exports::MapLayout* own = layout.get();
  layout->place = [own, face](std::int32_t triangle, const std::array<float, 3>& weights) {
    const Eigen::Vector3i corner = own->triangles.col(triangle);
    const Eigen::Vector3f by(weights.data());
    const Eigen::Vector3f point_mm = own->vertices_mm(Eigen::all, corner) * by;
    const Eigen::Vector3f normal = (own->normals(Eigen::all, corner) * by).normalized();
    const avatar::FaceUnderSkin::Point point = face->under(point_mm, normal);
    return exports::MapLayout::Place{point.triangle, point.weights, point.strength};
  };
  return layout;
}

/// The take's relief in the avatar's texture coordinates, a picture a frame. Returns the signal that broke it
/// off, or 0.
int write_maps(const RetargetOptions& options, const avatar::GlbDocument& glb, const avatar::Avatar& found,
               const StopSignals& signals) {
  std::vector<std::pair<exports::MapKind, std::filesystem::path>> wanted;
  for (const auto& [kind, folder] : {std::pair{exports::MapKind::Displacement, options.displacement_maps},
                                     {exports::MapKind::TangentNormal, options.normal_maps}}) {
    if (!folder.empty()) {
      wanted.emplace_back(kind, folder);
    }
  }
  if (wanted.empty()) {
    return 0;
  }
  take::TakeReader reader(options.take);
  const std::vector<std::int64_t> selection = frames_in_range(reader, options.frames);
  std::optional<exports::MapBaker> baker;
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  const auto format = options.map_format == "png" ? exports::PictureFormat::Png : exports::PictureFormat::Exr;
  Progress progress("Maps", selection.size());
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      return signal;
    }
    const auto frame = reader.frame(index, take::Pictures::Described);
    progress.advance();
    if (!mesh::has_mesh(*frame)) {
      continue;
    }
    if (!baker) {
      baker.emplace(options.size_px, map_layout(options, glb, found, *frame));
      hierarchy = frame->subject->hierarchy;
      for (const auto& [kind, folder] : wanted) {
        files::make_folder(folder);
      }
    }
    if (frame->subject->hierarchy != hierarchy) {
      throw Error(ErrorKind::Usage,
                  fmt::format("the person was estimated anew at frame {}: choose frames before or after with "
                              "--frames",
                              frame->sequence));
    }
    for (const auto& [kind, folder] : wanted) {
      exports::write_map(baker->bake(*frame, kind), kind, format,
                         folder / fmt::format("frame_{:06}.{}", frame->sequence, options.map_format));
    }
  }
  return 0;
}

void run_retarget(const RetargetOptions& options) {
  const StopSignals signals;
  avatar::GlbDocument glb = avatar::read_glb(options.avatar);
  const avatar::Avatar found =
      avatar::inspect_avatar(glb, options.head.empty() ? std::nullopt : std::optional(options.head));
  Performance performance;
  if (const int signal = read_performance(options, signals, performance); signal != 0) {
    tell(stderr, "facet: broken off: nothing was written to '{}'\n", options.output);
    signals.die_of(signal);
  }
  check_avatar(options, found, performance.states);
  for (const std::string& folder : {options.displacement_maps, options.normal_maps}) {
    if (!folder.empty()) {
      warn_of_varying_rate(performance.timeline, folder);
    }
  }
  if (const int signal = write_maps(options, glb, found, signals); signal != 0) {
    tell(stderr, "facet: broken off: the maps are not complete, nothing was written to '{}'\n",
         options.output);
    signals.die_of(signal);
  }
  avatar::add_animation(glb, found, performance.states, performance.times_s, !options.no_head);
  avatar::write_glb(glb, options.output);
  tell("{}: {} frames, {:.2f} s, {} meshes\n", options.output, performance.states.size(),
       performance.times_s.back(), found.meshes.size());
}

}  // namespace

void add_retarget_command(Command app) {
  auto options = std::make_shared<RetargetOptions>();
  const Command command =
      app.subcommand("retarget", "Put a take's expressions and head turns on an avatar (GLB, VRM)");
  command.option("TAKE", options->take, "Take file").required();
  command
      .option("--avatar,--rig", options->avatar,
              "The avatar: a GLB file whose morph targets have ARKit's names")
      .required();
  command.option("--frames", options->frames, kFramesHelp);
  command.option(
      "--neutral", options->neutral,
      "Number of the frame in which the face is at rest and looks straight ahead; default: the model's "
      "neutral face, and the camera is straight ahead");
  command.option(
      "--head", options->head,
      "Node that turns with the head; default: VRM's head bone, else a name that ends with \"head\"");
  command.flag("--no-head", options->no_head, "Leave the head still");
  command.flag("--allow-missing", options->allow_missing,
               "Go on where the avatar lacks shapes that the take moves");
  command.option(
      "--displacement-maps", options->displacement_maps,
      "Folder: the take's displacements in the avatar's texture coordinates, a picture for each frame");
  command.option("--normal-maps", options->normal_maps,
                 "Folder: the same as normals against the avatar's surface");
  command.option("--map-format,--pictures", options->map_format, "Format of the maps: exr, png")
      .one_of({"exr", "png"})
      .shows_default();
  command.option("--size", options->size_px, "Width and height of the maps, pixels")
      .range(16, 16384)
      .shows_default();
  command.option("--model", options->model,
                 "Face model that the take was made with (for maps); default: the "
                 "configured one");
  command.option("-o,--output", options->output, "GLB file: the avatar with an animation more").required();
  command.callback([options] { run_retarget(*options); });
}

}  // namespace facet::tools
