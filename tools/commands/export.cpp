// `facet export`: meshes and signals of a take in formats that other programs read.

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "exports/formats.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "report/set_pictures.hpp"
#include "stop_signals.hpp"
#include "take/reader.hpp"
#include "take_film.hpp"
#include "take_frames.hpp"
#include "take_person.hpp"
#include "take_sound.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct ExportOptions {
  std::string take;
  std::string format;
  std::string frames;
  std::string level = "finest";
  std::string space = "camera";
  std::string axes;
  std::string compress = "none";
  std::string map_format = "exr";
  int size_px = 0;  ///< 0: kMapSize_px, of films kFilmHeight_px
  std::string panels;
  std::string video;
  std::string model;
  std::string output;
};

using exports::ExportFormat;

constexpr int kMapSize_px = 1024;
constexpr int kFilmHeight_px = 720;

const ExportFormat& format_of(const ExportOptions& options) {
  const auto formats = exports::export_formats();
  return *std::find_if(formats.begin(), formats.end(),
                       [&](const ExportFormat& format) { return options.format == format.name; });
}

std::string formats_help() {
  std::string text;
  for (const ExportFormat& format : exports::export_formats()) {
    text += fmt::format("{}{}: {}", text.empty() ? "" : "; ", format.name, format.help);
  }
  return text;
}

/// The names of the formats that `wanted` holds for.
template <typename Wanted>
std::vector<std::string> names_of(Wanted wanted) {
  std::vector<std::string> names;
  for (const ExportFormat& format : exports::export_formats()) {
    if (wanted(format)) {
      names.emplace_back(format.name);
    }
  }
  return names;
}

bool is_any(const ExportFormat& /*format*/) {
  return true;
}
bool is_one_file(const ExportFormat& format) {
  return format.is_one_file();
}
bool is_text(const ExportFormat& format) {
  return std::holds_alternative<exports::Lines>(format.writes);
}
bool compresses(const ExportFormat& format) {
  const auto* animation = std::get_if<exports::Animation>(&format.writes);
  return animation != nullptr && animation->compresses;
}
bool has_axes(const ExportFormat& format) {
  const auto* files = std::get_if<exports::FrameFiles>(&format.writes);
  return files != nullptr && files->has_axes;
}
bool has_no_node(const ExportFormat& format) {
  const auto* animation = std::get_if<exports::Animation>(&format.writes);
  return animation != nullptr && animation->has_no_node;
}

bool has_picture(const ExportFormat& format) {
  const auto* files = std::get_if<exports::FrameFiles>(&format.writes);
  const auto* animation = std::get_if<exports::Animation>(&format.writes);
  return (files != nullptr && files->has_picture) || (animation != nullptr && animation->has_picture);
}
bool is_film(const ExportFormat& format) {
  return std::holds_alternative<exports::Film>(format.writes);
}
bool is_in_expressions(const ExportFormat& format) {
  const auto* animation = std::get_if<exports::Animation>(&format.writes);
  return animation != nullptr && animation->in_expressions;
}

/// A person's albedo as a picture, baked anew where it changed.
class SkinPicture {
 public:
  explicit SkinPicture(int size_px) : baker_(size_px) {}

  /// Null where the frame has no albedo.
  std::shared_ptr<const std::vector<std::uint8_t>> of(const mesh::MeshFrame& frame) {
    if (frame.albedo == nullptr) {
      return nullptr;
    }
    const std::pair shown(frame.subject->id, frame.albedo->version);
    if (png_ == nullptr || shown != shown_) {
      shown_ = shown;
      png_ = std::make_shared<const std::vector<std::uint8_t>>(
          exports::encode_skin(baker_.bake(frame, exports::MapKind::Albedo)));
    }
    return png_;
  }

 private:
  exports::MapBaker baker_;
  std::pair<std::uint64_t, std::uint64_t> shown_;  ///< subject and version of the albedo
  std::shared_ptr<const std::vector<std::uint8_t>> png_;
};

/// Indices in the take.
using Selection = std::vector<std::int64_t>;

int map_size_px(const ExportOptions& options) {
  return options.size_px > 0 ? options.size_px : kMapSize_px;
}

exports::MeshLevel level_of(const ExportOptions& options) {
  return options.level == "coarse" ? exports::MeshLevel::Coarse : exports::MeshLevel::Finest;
}

/// "3, 7-9" for the sorted numbers 3, 7, 8, 9.
std::string ranges_text(const std::vector<std::uint64_t>& numbers) {
  std::string text;
  for (std::size_t i = 0; i < numbers.size();) {
    std::size_t last = i;
    while (last + 1 < numbers.size() && numbers[last + 1] == numbers[last] + 1) {
      ++last;
    }
    text += fmt::format("{}{}", text.empty() ? "" : ", ", numbers[i]);
    text += last > i ? fmt::format("-{}", numbers[last]) : "";
    i = last + 1;
  }
  return text;
}

/// Throws Error(NoFace) where no frame is left.
void tell_left_out(const std::vector<std::uint64_t>& without_mesh, std::size_t selected) {
  if (!without_mesh.empty()) {
    tell(stderr, "{} of {} frames have no mesh (no face was tracked) and were left out: {}\n",
         without_mesh.size(), selected, ranges_text(without_mesh));
  }
  if (without_mesh.size() == selected) {
    throw Error(ErrorKind::NoFace, "none of the selected frames has a mesh: nothing was written");
  }
}

/// An output path that ends like a mesh file is one, anything else is a folder.
bool names_a_file(const std::filesystem::path& output, const ExportFormat& format) {
  return output.extension() == fmt::format(".{}", format.extension) && !std::filesystem::is_directory(output);
}

/// Returns the signal that broke it off, or 0.
int export_meshes(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                  const ExportFormat& format, const StopSignals& signals) {
  const exports::MeshLevel level = level_of(options);
  const auto axes = options.axes == "camera" ? exports::MeshAxes::Camera : exports::MeshAxes::Upright;
  const std::filesystem::path output = options.output;
  const bool one_file = names_a_file(output, format);
  if (one_file && selection.size() != 1) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' is one file, but {} frames are selected: choose one with --frames N:N+1, or name a "
                    "folder",
                    options.output, selection.size()));
  }
  files::make_folder(one_file ? std::filesystem::absolute(output).parent_path() : output);

  Progress progress("Exporting", selection.size());
  const auto& writes = std::get<exports::FrameFiles>(format.writes);
  exports::ExportMesh mesh;
  SkinPicture skin(map_size_px(options));
  std::vector<std::uint64_t> without_mesh;
  std::size_t done = 0;
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: '{}' holds {} of the {} frames\n", options.output,
           done - without_mesh.size(), selection.size());
      return signal;
    }
    ++done;
    const auto frame = reader.frame(index, take::Pictures::Described);
    if (mesh::has_mesh(*frame)) {
      exports::build_export_mesh(*frame, level, exports::MeshSpace::Camera, mesh);
      mesh.skin_png = writes.has_picture ? skin.of(*frame) : nullptr;
      const std::string name = fmt::format("frame_{:06}.{}", frame->sequence, format.extension);
      writes.write(mesh, one_file ? output : output / name, axes);
    } else {
      without_mesh.push_back(frame->sequence);
    }
    progress.advance();
  }
  progress.finish();
  const std::size_t written = selection.size() - without_mesh.size();
  tell_left_out(without_mesh, selection.size());
  tell("{}: {} {} file{}, {} mesh, {} vertices\n", options.output, written, options.format,
       written == 1 ? "" : "s", options.level, mesh.vertices_mm.cols());
  return 0;
}

/// The frames of a selection that have a mesh; the others are told.
Selection with_mesh(take::TakeReader& reader, const Selection& selection) {
  Selection meshes;
  std::vector<std::uint64_t> without_mesh;
  for (const std::int64_t index : selection) {
    const take::FrameEntry entry = reader.entry(index);
    if (entry.has_mesh) {
      meshes.push_back(index);
    } else {
      without_mesh.push_back(entry.sequence);
    }
  }
  tell_left_out(without_mesh, selection.size());
  return meshes;
}

/// A folder's files bear numbers. Where the source's times start anew there is no rate to warn of.
void warn_of_numbers(take::TakeReader& reader, const Selection& selection, const std::string& output) {
  try {
    warn_of_varying_rate(timeline_of(reader, selection), output);
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::UnreadableInput) {
      throw;
    }
  }
}

/// Those of the take's model. Throws as person_shapes does, naming the formats that need no model.
face::ExpressionBasis basis_of(const mesh::MeshFrame& frame, const ExportOptions& options) {
  try {
    return person_shapes(frame, options.take, options.model);
  } catch (const Error& error) {
    throw Error(error.kind(),
                fmt::format("{}; glb-frames and usda-frames do without expressions", error.what()));
  }
}

/// The coarse level's neutral face, expressions and eyeballs.
exports::ExpressionShapes expression_shapes(const mesh::MeshFrame& frame, const ExportOptions& options) {
  const face::ExpressionBasis basis = basis_of(frame, options);
  const mesh::SparseRows& coarse = frame.subject->hierarchy->levels.front().from_coarser;
  exports::ExpressionShapes shapes;
  shapes.names = frame.subject->expression_names;
  mesh::apply(coarse, basis.neutral_mm, shapes.neutral_mm);
  for (const mesh::Vertices& delta : basis.deltas_mm) {
    mesh::apply(coarse, delta, shapes.deltas_mm.emplace_back());
  }
  std::vector<std::uint8_t> is_eye;
  for (const std::uint8_t regions : frame.subject->regions) {
    is_eye.push_back(face::has_region(regions, face::Region::Eye) ? 1 : 0);
  }
  shapes.eyeballs =
      exports::find_eyeballs(shapes.neutral_mm, frame.subject->hierarchy->levels.front().triangles, is_eye);
  return shapes;
}

/// Gives the first frame's mesh, whose colours a file shows, those of the last frame: what was learned by
/// then. size_px: of the picture; 0: none
void dress(exports::ExportMesh& mesh, const mesh::MeshFrame& last, int size_px) {
  const auto count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  if (last.albedo != nullptr && last.albedo->linear_rgb.size() >= 3 * count) {
    mesh.albedo =
        Eigen::Map<const mesh::Vertices>(last.albedo->linear_rgb.data(), 3, mesh.vertices_mm.cols());
    mesh.skin_png = size_px > 0 ? SkinPicture(size_px).of(last) : nullptr;
  }
}

/// One file of many frames. Returns the signal that broke it off, or 0.
int export_sequence(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                    const ExportFormat& format, const StopSignals& signals) {
  const auto& animation = std::get<exports::Animation>(format.writes);
  const Selection meshes = with_mesh(reader, selection);
  const bool expressions = animation.in_expressions;
  const exports::MeshLevel level = expressions ? exports::MeshLevel::Coarse : level_of(options);
  exports::SequenceOptions sequence;
  sequence.file = options.output;
  sequence.timeline = timeline_of(reader, meshes);
  sequence.timeline.timecode = reader.info().timecode;
  sequence.compression =
      options.compress == "meshopt" ? exports::GlbCompression::Meshopt : exports::GlbCompression::None;
  sequence.space = options.space == "head" ? exports::MeshSpace::Head : exports::MeshSpace::Camera;
  if (sequence.file.extension() != fmt::format(".{}", format.extension)) {
    throw Error(ErrorKind::Usage, fmt::format("--format {} writes one file: name it with -o NAME.{}",
                                              options.format, format.extension));
  }
  files::make_folder(std::filesystem::absolute(sequence.file).parent_path());

  Progress progress("Exporting", meshes.size());
  std::unique_ptr<exports::SequenceWriter> writer;
  exports::SequenceFrame next;
  for (const std::int64_t index : meshes) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: nothing was written to '{}'\n", options.output);
      return signal;
    }
    const auto frame = reader.frame(index, take::Pictures::Described);
    next.sequence = frame->sequence;
    next.camera_from_head = frame->camera_from_head;
    next.expression = expressions ? mesh::shape_weights(*frame) : frame->expression;
    exports::build_export_mesh(*frame, level, exports::MeshSpace::Head, next.mesh);
    if (writer == nullptr) {
      if (expressions) {
        sequence.shapes = expression_shapes(*frame, options);
      }
      dress(next.mesh, *reader.frame(meshes.back(), take::Pictures::Described),
            animation.has_picture ? map_size_px(options) : 0);
      writer = animation.open(sequence, next);
    }
    writer->add(next);
    progress.advance();
  }
  writer->commit();
  progress.finish();
  if (animation.has_no_node) {
    warn_of_varying_rate(sequence.timeline, options.output);
  }
  tell("{}: {} frames, {} to {} of the source at {}{:.6g} Hz, {} vertices\n", options.output, meshes.size(),
       sequence.timeline.sequences.front(), sequence.timeline.sequences.back(),
       sequence.timeline.times_s.empty() ? "" : "a varying rate, on average ", sequence.timeline.rate_hz,
       next.mesh.vertices_mm.cols());
  return 0;
}

/// Returns the signal that broke it off, or 0.
int export_maps(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                exports::MapKind kind, const StopSignals& signals) {
  const Selection meshes = with_mesh(reader, selection);
  const auto format = options.map_format == "png" ? exports::PictureFormat::Png : exports::PictureFormat::Exr;
  const std::filesystem::path folder = options.output;
  exports::MapBaker baker(map_size_px(options));
  files::make_folder(folder);
  Progress progress("Exporting", meshes.size());
  std::uint64_t albedo_version = 0;
  std::size_t written = 0;
  for (const std::int64_t index : meshes) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: '{}' holds {} maps\n", options.output, written);
      return signal;
    }
    const auto frame = reader.frame(index, take::Pictures::Described);
    const bool wanted = kind != exports::MapKind::Albedo ||
                        (frame->albedo != nullptr &&
                         std::exchange(albedo_version, frame->albedo->version) != frame->albedo->version);
    if (wanted) {
      exports::write_map(baker.bake(*frame, kind), kind, format,
                         folder / fmt::format("frame_{:06}.{}", frame->sequence, options.map_format));
      ++written;
    }
    progress.advance();
  }
  progress.finish();
  if (written == 0) {
    throw Error(ErrorKind::NoFace,
                fmt::format("none of the selected frames of '{}' has an albedo", options.take));
  }
  tell("{}: {} {} maps, {} x {} px\n", options.output, written, options.format, map_size_px(options),
       map_size_px(options));
  return 0;
}

/// Lines of text, one for each frame. Returns the signal that broke it off, or 0.
int export_lines(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                 const exports::Lines& lines, const StopSignals& signals) {
  const bool to_standard_output = options.output == "-";
  std::unique_ptr<files::OutputFile> file;
  if (!to_standard_output) {
    file = std::make_unique<files::OutputFile>(options.output);
  }
  exports::Timeline timeline = lines.in_time ? timeline_of(reader, selection) : exports::Timeline();
  timeline.timecode = reader.info().timecode;
  if (!lines.in_time) {
    timeline.rate_hz = source_rate_hz(reader);
  }
  const auto write = [&](const std::string& text) {
    if (to_standard_output) {
      std::fwrite(text.data(), 1, text.size(), stdout);
    } else {
      file->write(text);
    }
  };
  write(lines.header());
  Progress progress("Exporting", selection.size());
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: {}\n",
           to_standard_output ? "the last line written is a whole one"
                              : fmt::format("nothing was written to '{}'", options.output));
      return signal;
    }
    const auto frame = reader.frame(index, take::Pictures::Described);
    write(lines.line(*frame, index, timeline));
    progress.advance();
  }
  progress.finish();
  if (!to_standard_output) {
    file->commit();
    tell("{}: {} frames\n", options.output, selection.size());
  }
  return 0;
}

/// Returns the signal that broke it off, or 0.
int export_pictures(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                    const StopSignals& signals) {
  Progress progress("Exporting", selection.size());
  std::size_t written = 0;
  std::vector<std::uint64_t> unreadable;
  std::string first_fault;
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: '{}' holds {} pictures\n", options.output, written);
      return signal;
    }
    std::shared_ptr<const FrameSet> images;
    try {
      images = reader.frame(index)->images;
    } catch (const Error& fault) {
      first_fault = unreadable.empty() ? fault.what() : first_fault;
      unreadable.push_back(reader.entry(index).sequence);
    }
    written += images != nullptr ? report::write_set_pictures(*images, options.output) : 0;
    progress.advance();
  }
  progress.finish();
  if (!unreadable.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}; '{}' holds {} pictures; {} of {} frames can't be read and were left out: {}",
                            first_fault, options.output, written, unreadable.size(), selection.size(),
                            ranges_text(unreadable)));
  }
  if (written == 0) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}' holds no pictures: they are recorded in modes \"frames\" and \"booth\"",
                            options.take));
  }
  tell("{}: {} pictures of {} frames\n", options.output, written, selection.size());
  return 0;
}

void run_export(const ExportOptions& options) {
  const ExportFormat& format = format_of(options);
  if (options.compress != "none" && !compresses(format)) {
    throw Error(ErrorKind::Usage, fmt::format("--compress is for {}, not for {}",
                                              fmt::join(names_of(compresses), " and "), options.format));
  }
  if (!options.axes.empty() && !has_axes(format)) {
    throw Error(ErrorKind::Usage, fmt::format("--axes is for {}, not for {}",
                                              fmt::join(names_of(has_axes), " and "), options.format));
  }
  if ((!options.panels.empty() || !options.video.empty()) && !is_film(format)) {
    throw Error(ErrorKind::Usage, fmt::format("--panels and --video are for {}, not for {}",
                                              fmt::join(names_of(is_film), " and "), options.format));
  }
  take::TakeReader reader(options.take);
  const take::TakeInfo& info = reader.info();
  if (!info.closed) {
    tell(stderr, "note: '{}' was not closed by its recorder; exporting the {} frames that are in it\n",
         options.take, info.frame_count);
  }
  const Selection selection = frames_in_range(reader, options.frames);
  const StopSignals signals;
  int broken_off_by = 0;
  if (!format.is_one_file()) {
    warn_of_numbers(reader, selection, options.output);
  }
  if (std::holds_alternative<exports::FrameFiles>(format.writes)) {
    broken_off_by = export_meshes(reader, selection, options, format, signals);
  } else if (std::holds_alternative<exports::Animation>(format.writes)) {
    broken_off_by = export_sequence(reader, selection, options, format, signals);
  } else if (const auto* maps = std::get_if<exports::Maps>(&format.writes)) {
    broken_off_by = export_maps(reader, selection, options, maps->kind, signals);
  } else if (std::holds_alternative<exports::Sound>(format.writes)) {
    export_sound(reader, selection,
                 options.format == "wav" ? sound::SoundEncoding::Wav : sound::SoundEncoding::Flac,
                 options.output);
  } else if (is_film(format)) {
    broken_off_by = export_film(reader, selection,
                                {options.panels, options.video,
                                 options.size_px > 0 ? options.size_px : kFilmHeight_px, options.output},
                                signals);
  } else if (const auto* lines = std::get_if<exports::Lines>(&format.writes)) {
    broken_off_by = export_lines(reader, selection, options, *lines, signals);
  } else {
    broken_off_by = export_pictures(reader, selection, options, signals);
  }
  if (broken_off_by != 0) {
    signals.die_of(broken_off_by);
  }
}

}  // namespace

void add_export_command(Command app) {
  auto options = std::make_shared<ExportOptions>();
  const Command command = app.subcommand(
      "export", "Write a take's meshes, animations, maps, curves or pictures for other programs");
  command.option("TAKE", options->take, "Take file").required();
  command.option("--format", options->format, formats_help()).required().one_of(names_of(is_any));
  command.option("--frames", options->frames, kFramesHelp);
  command.option("--level", options->level, "coarse: the tracked mesh; finest: the refined one")
      .shows_default()
      .one_of({"coarse", "finest"});
  command
      .option("--space", options->space,
              fmt::format("{}: camera has the head's movement in the vertices, head is held still",
                          fmt::join(names_of(has_no_node), ", ")))
      .shows_default()
      .one_of({"camera", "head"});
  command
      .option("--axes", options->axes,
              fmt::format("{}: upright (default): {}; camera: {}", fmt::join(names_of(has_axes), ", "),
                          exports::words_of(exports::MeshAxes::Upright),
                          exports::words_of(exports::MeshAxes::Camera)))
      .one_of({"upright", "camera"});
  command
      .option(
          "--compress", options->compress,
          fmt::format(
              "{}: meshopt makes a file a third of the size, which needs a reader of "
              "EXT_meshopt_compression (three.js, Babylon.js, Unity's glTFast; not Blender); vertices are "
              "rounded to 0.002 mm",
              fmt::join(names_of(compresses), ", ")))
      .shows_default()
      .one_of({"none", "meshopt"});
  command
      .option("--map-format,--pictures", options->map_format,
              "Maps: exr has the values themselves as 32-bit floats, png 16 bits a channel")
      .shows_default()
      .one_of({"png", "exr"});
  command
      .option(
          "--size", options->size_px,
          fmt::format(
              "Maps, and the picture of the skin in {}: width and height, pixels ({}); {}: height ({})",
              fmt::join(names_of(has_picture), ", "), kMapSize_px, names_of(is_film).front(), kFilmHeight_px))
      .range(16, 16384);
  command.option("--panels", options->panels,
                 fmt::format("{}: what stands side by side, of picture, mesh, grey, skin and normals, with "
                             "commas between (picture,grey,skin, without picture where there is none)",
                             names_of(is_film).front()));
  command.option("--video", options->video,
                 fmt::format("{}: video or take with the pictures, where it is another than the take or its "
                             "source",
                             names_of(is_film).front()));
  command.option("--model", options->model,
                 fmt::format("{}: the face model that the take was made with",
                             fmt::join(names_of(is_in_expressions), ", ")));
  command
      .option(
          "-o,--output", options->output,
          fmt::format(
              "What is one file for all frames ({}): the file; {}: - is standard output. Else the folder for "
              "frame_%06d files (the number of the source's frame), or one file for one frame's mesh",
              fmt::join(names_of(is_one_file), ", "), fmt::join(names_of(is_text), " and ")))
      .required();
  command.callback([options] { run_export(*options); });
}

}  // namespace facet::tools
