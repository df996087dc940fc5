// `facet export`: meshes and signals of a take in formats that other programs read.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "commands.hpp"
#include "exports/export.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "progress.hpp"
#include "report/set_pictures.hpp"
#include "stop_signals.hpp"
#include "take/reader.hpp"
#include "take_frames.hpp"
#include "take_person.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct ExportOptions {
  std::string take;
  std::string format;
  std::string frames;
  std::string level = "finest";
  std::string space = "camera";
  std::string compress = "none";
  std::string pictures = "exr";
  int size_px = 2048;
  std::string model;
  std::string output;
};

/// A format and what writes it; the order is that of the help.
struct Format {
  const char* name;
  const char* help;
  std::variant<std::monostate, exports::MeshFormat, exports::SequenceFormat, exports::MapKind> writer;
};
const std::array kFormats = {
    Format{"ply", "a mesh for each frame, camera frame, mm, x right, y down, z forward",
           exports::MeshFormat::Ply},
    Format{"obj", "the same as text", exports::MeshFormat::Obj},
    Format{"glb", "the same as glTF 2.0, metres, y up", exports::MeshFormat::Glb},
    Format{"glb-frames", "one animated GLB: every frame a morph target, the head's pose on the node",
           exports::SequenceFormat::GlbFrames},
    Format{"glb-expressions",
           "one animated GLB: the coarse mesh, the expressions as morph targets, the head's pose",
           exports::SequenceFormat::GlbExpressions},
    Format{"usda", "one mesh with time samples, the head's pose as its transform, metres, y up",
           exports::SequenceFormat::Usda},
    Format{"pc2", "a vertex cache and the OBJ that it is for, metres, y up", exports::SequenceFormat::Pc2},
    Format{"mdd", "the same for programs that read MDD", exports::SequenceFormat::Mdd},
    Format{"displacement", "a map for each frame: mm along the smooth surface's normal",
           exports::MapKind::Displacement},
    Format{"normal", "a map for each frame: normals in the head frame", exports::MapKind::ObjectNormal},
    Format{"tangent-normal", "a map for each frame: normals against the smooth surface",
           exports::MapKind::TangentNormal},
    Format{"albedo", "a map whenever the albedo changed", exports::MapKind::Albedo},
    Format{"csv", "ARKit's 52 curves and angles in the columns of Live Link Face", {}},
    Format{"jsonl", "one object per frame", {}},
    Format{"png", "the cameras' pictures, where they were recorded", {}},
};

const Format& format_of(const ExportOptions& options) {
  return *std::find_if(kFormats.begin(), kFormats.end(),
                       [&](const Format& format) { return options.format == format.name; });
}

std::string formats_help() {
  std::string text;
  for (const Format& format : kFormats) {
    text += fmt::format("{}{}: {}", text.empty() ? "" : "; ", format.name, format.help);
  }
  return text;
}

std::vector<std::string> format_names() {
  std::vector<std::string> names;
  names.reserve(std::size(kFormats));
  for (const Format& format : kFormats) {
    names.emplace_back(format.name);
  }
  return names;
}

/// Indices in the take.
using Selection = std::vector<std::int64_t>;

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
bool names_a_file(const std::filesystem::path& output, exports::MeshFormat format) {
  return output.extension() == fmt::format(".{}", exports::extension(format)) &&
         !std::filesystem::is_directory(output);
}

/// Returns the signal that broke it off, or 0.
int export_meshes(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                  exports::MeshFormat format, const StopSignals& signals) {
  const exports::MeshLevel level = level_of(options);
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
  exports::ExportMesh mesh;
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
      const std::string name = fmt::format("frame_{:06}.{}", frame->sequence, exports::extension(format));
      exports::write_mesh(format, mesh, one_file ? output : output / name);
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

/// The coarse level's neutral face and expressions.
exports::ExpressionShapes expression_shapes(const mesh::MeshFrame& frame, const ExportOptions& options) {
  const face::ExpressionBasis basis = person_shapes(frame, options.take, options.model);
  const mesh::SparseRows& coarse = frame.subject->hierarchy->levels.front().from_coarser;
  exports::ExpressionShapes shapes;
  shapes.names = frame.subject->expression_names;
  mesh::apply(coarse, basis.neutral_mm, shapes.neutral_mm);
  for (const mesh::Vertices& delta : basis.deltas_mm) {
    mesh::apply(coarse, delta, shapes.deltas_mm.emplace_back());
  }
  return shapes;
}

/// One file of many frames. Returns the signal that broke it off, or 0.
int export_sequence(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                    exports::SequenceFormat format, const StopSignals& signals) {
  const Selection meshes = with_mesh(reader, selection);
  const bool expressions = format == exports::SequenceFormat::GlbExpressions;
  const exports::MeshLevel level = expressions ? exports::MeshLevel::Coarse : level_of(options);
  exports::SequenceOptions sequence;
  sequence.file = options.output;
  sequence.timeline = timeline_of(reader, meshes);
  sequence.compression =
      options.compress == "meshopt" ? exports::GlbCompression::Meshopt : exports::GlbCompression::None;
  sequence.space = options.space == "head" ? exports::MeshSpace::Head : exports::MeshSpace::Camera;
  if (sequence.file.extension() != fmt::format(".{}", exports::extension(format))) {
    throw Error(ErrorKind::Usage, fmt::format("--format {} writes one file: name it with -o NAME.{}",
                                              options.format, exports::extension(format)));
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
    next.expression = frame->expression;
    exports::build_export_mesh(*frame, level, exports::MeshSpace::Head, next.mesh);
    if (writer == nullptr) {
      if (expressions) {
        sequence.shapes = expression_shapes(*frame, options);
      }
      writer = exports::open_sequence(format, sequence, next);
    }
    writer->add(next);
    progress.advance();
  }
  writer->commit();
  progress.finish();
  if (format == exports::SequenceFormat::Pc2 || format == exports::SequenceFormat::Mdd) {
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
  const auto format = options.pictures == "png" ? exports::PictureFormat::Png : exports::PictureFormat::Exr;
  const std::filesystem::path folder = options.output;
  exports::MapBaker baker(options.size_px);
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
                         folder / fmt::format("frame_{:06}.{}", frame->sequence, options.pictures));
      ++written;
    }
    progress.advance();
  }
  progress.finish();
  if (written == 0) {
    throw Error(ErrorKind::NoFace,
                fmt::format("none of the selected frames of '{}' has an albedo", options.take));
  }
  tell("{}: {} {} maps, {} x {} px\n", options.output, written, options.format, options.size_px,
       options.size_px);
  return 0;
}

/// Lines of text, one for each frame. Returns the signal that broke it off, or 0.
int export_signals(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                   const StopSignals& signals) {
  const bool to_standard_output = options.output == "-";
  std::unique_ptr<files::OutputFile> file;
  if (!to_standard_output) {
    file = std::make_unique<files::OutputFile>(options.output);
  }
  const bool curves = options.format == "csv";
  const exports::Timeline timeline = curves ? timeline_of(reader, selection) : exports::Timeline();
  const auto write = [&](const std::string& text) {
    if (to_standard_output) {
      std::fwrite(text.data(), 1, text.size(), stdout);
    } else {
      file->write(text);
    }
  };
  if (curves) {
    write(exports::live_link_header());
  }
  Progress progress("Exporting", selection.size());
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: {}\n",
           to_standard_output ? "the last line written is a whole one"
                              : fmt::format("nothing was written to '{}'", options.output));
      return signal;
    }
    const auto frame = reader.frame(index, take::Pictures::Described);
    write(curves ? exports::live_link_line(*frame, timeline) : exports::frame_json(*frame, index) + "\n");
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
  if (options.compress != "none" && options.format != "glb-frames" && options.format != "glb-expressions") {
    throw Error(ErrorKind::Usage,
                fmt::format("--compress is for glb-frames and glb-expressions, not for {}", options.format));
  }
  take::TakeReader reader(options.take);
  const take::TakeInfo& info = reader.info();
  if (!info.closed) {
    tell(stderr, "note: '{}' was not closed by its recorder; exporting the {} frames that are in it\n",
         options.take, info.frame_count);
  }
  const Selection selection = frames_in_range(reader, options.frames);
  const StopSignals signals;
  const auto& writer = format_of(options).writer;
  int broken_off_by = 0;
  if (options.format == "png" || std::holds_alternative<exports::MeshFormat>(writer) ||
      std::holds_alternative<exports::MapKind>(writer)) {
    warn_of_numbers(reader, selection, options.output);
  }
  if (const auto* mesh = std::get_if<exports::MeshFormat>(&writer)) {
    broken_off_by = export_meshes(reader, selection, options, *mesh, signals);
  } else if (const auto* sequence = std::get_if<exports::SequenceFormat>(&writer)) {
    broken_off_by = export_sequence(reader, selection, options, *sequence, signals);
  } else if (const auto* map = std::get_if<exports::MapKind>(&writer)) {
    broken_off_by = export_maps(reader, selection, options, *map, signals);
  } else {
    broken_off_by = options.format == "png" ? export_pictures(reader, selection, options, signals)
                                            : export_signals(reader, selection, options, signals);
  }
  if (broken_off_by != 0) {
    signals.die_of(broken_off_by);
  }
}

}  // namespace

void add_export_command(CLI::App& app) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* command = app.add_subcommand(
      "export", "Write a take's meshes, animations, maps, curves or pictures for other programs");
  command->add_option("TAKE", options->take, "Take file")->required();
  command->add_option("--format", options->format, formats_help())
      ->required()
      ->check(CLI::IsMember(format_names()));
  command->add_option("--frames", options->frames, kFramesHelp);
  command->add_option("--level", options->level, "coarse: the tracked mesh; finest: the refined one")
      ->capture_default_str()
      ->check(CLI::IsMember({"coarse", "finest"}));
  command
      ->add_option("--space", options->space,
                   "pc2, mdd: camera has the head's movement in the vertices, head is held still")
      ->capture_default_str()
      ->check(CLI::IsMember({"camera", "head"}));
  command
      ->add_option(
          "--compress", options->compress,
          "glb-frames, glb-expressions: meshopt makes a file a third of the size, which needs a reader of "
          "EXT_meshopt_compression (three.js, Babylon.js, Unity's glTFast; not Blender); vertices are "
          "rounded to 0.002 mm")
      ->capture_default_str()
      ->check(CLI::IsMember({"none", "meshopt"}));
  command
      ->add_option("--pictures", options->pictures,
                   "Maps: exr has the values themselves as 32-bit floats, png 16 bits a channel")
      ->capture_default_str()
      ->check(CLI::IsMember({"png", "exr"}));
  command->add_option("--size", options->size_px, "Maps: width and height, pixels")
      ->capture_default_str()
      ->check(CLI::Range(16, 16384));
  command->add_option("--model", options->model,
                      "glb-expressions: the face model that the take was made with");
  command
      ->add_option(
          "-o,--output", options->output,
          "What is one file for all frames (glb-frames, glb-expressions, usda, pc2, mdd, csv, jsonl): the "
          "file; csv and jsonl: - is standard output. Else the folder for frame_%06d files (the number of "
          "the source's frame), or one file for one frame's mesh")
      ->required();
  command->callback([options] { run_export(*options); });
}

}  // namespace facet::tools
