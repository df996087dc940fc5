// `facet export`: meshes and signals of a take in formats that other programs read.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "commands.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "progress.hpp"
#include "set_pictures.hpp"
#include "stop_signals.hpp"
#include "take/export.hpp"
#include "take/reader.hpp"
#include "take_frames.hpp"

namespace facet::tools {
namespace {

struct ExportOptions {
  std::string take;
  std::string format;
  std::string frames;
  std::string level = "finest";
  std::string output;
};

/// Indices in the take.
using Selection = std::vector<std::int64_t>;

take::MeshFormat mesh_format(const std::string& name) {
  return name == "ply"   ? take::MeshFormat::Ply
         : name == "obj" ? take::MeshFormat::Obj
                         : take::MeshFormat::Glb;
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

void make_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!std::filesystem::is_directory(folder)) {
    throw Error(ErrorKind::Storage, fmt::format("cannot make the folder '{}': {}", folder.string(),
                                                error ? error.message() : "a file of that name is there"));
  }
}

/// An output path that ends like a mesh file is one, anything else is a folder.
bool names_a_file(const std::filesystem::path& output, take::MeshFormat format) {
  return output.extension() == fmt::format(".{}", take::extension(format)) &&
         !std::filesystem::is_directory(output);
}

/// Returns the signal that broke it off, or 0.
int export_meshes(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                  const StopSignals& signals) {
  const take::MeshFormat format = mesh_format(options.format);
  const take::MeshLevel level = options.level == "coarse" ? take::MeshLevel::Coarse : take::MeshLevel::Finest;
  const std::filesystem::path output = options.output;
  const bool one_file = names_a_file(output, format);
  if (one_file && selection.size() != 1) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' is one file, but {} frames are selected: choose one with --frames N:N+1, or name a "
                    "folder",
                    options.output, selection.size()));
  }
  make_folder(one_file ? std::filesystem::absolute(output).parent_path() : output);

  Progress progress("Exporting", selection.size());
  take::ExportMesh mesh;
  std::vector<std::uint64_t> without_mesh;
  std::size_t done = 0;
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      fmt::print(stderr, "facet: broken off: '{}' holds {} of the {} frames\n", options.output,
                 done - without_mesh.size(), selection.size());
      return signal;
    }
    ++done;
    const auto frame = reader.frame(index, take::Pictures::Described);
    if (take::has_mesh(*frame)) {
      take::build_export_mesh(*frame, level, mesh);
      const std::string name = fmt::format("frame_{:06}.{}", frame->sequence, take::extension(format));
      take::write_mesh(format, mesh, one_file ? output : output / name);
    } else {
      without_mesh.push_back(frame->sequence);
    }
    progress.advance();
  }
  progress.finish();
  const std::size_t written = selection.size() - without_mesh.size();
  if (!without_mesh.empty()) {
    fmt::print(stderr, "{} of {} frames have no mesh (no face was tracked) and were left out: {}\n",
               without_mesh.size(), selection.size(), ranges_text(without_mesh));
  }
  if (written == 0) {
    throw Error(ErrorKind::NoFace, "none of the selected frames has a mesh: nothing was written");
  }
  fmt::print("{}: {} {} file{}, {} mesh, {} vertices\n", options.output, written, options.format,
             written == 1 ? "" : "s", options.level, mesh.vertices_mm.cols());
  return 0;
}

/// Returns the signal that broke it off, or 0.
int export_signals(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                   const StopSignals& signals) {
  const bool to_standard_output = options.output == "-";
  std::unique_ptr<files::OutputFile> file;
  if (!to_standard_output) {
    file = std::make_unique<files::OutputFile>(options.output);
  }
  Progress progress("Exporting", selection.size());
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      fmt::print(stderr, "facet: broken off: {}\n",
                 to_standard_output ? "the last line written is a whole one"
                                    : fmt::format("nothing was written to '{}'", options.output));
      return signal;
    }
    const std::string line = take::frame_json(*reader.frame(index, take::Pictures::Described), index) + "\n";
    if (to_standard_output) {
      fmt::print("{}", line);
    } else {
      file->write(line);
    }
    progress.advance();
  }
  progress.finish();
  if (!to_standard_output) {
    file->commit();
    fmt::print("{}: {} frames\n", options.output, selection.size());
  }
  return 0;
}

/// Returns the signal that broke it off, or 0.
int export_pictures(take::TakeReader& reader, const Selection& selection, const ExportOptions& options,
                    const StopSignals& signals) {
  make_folder(options.output);
  Progress progress("Exporting", selection.size());
  std::size_t written = 0;
  std::vector<std::uint64_t> unreadable;
  std::string first_fault;
  for (const std::int64_t index : selection) {
    if (const int signal = signals.pending(); signal != 0) {
      fmt::print(stderr, "facet: broken off: '{}' holds {} pictures\n", options.output, written);
      return signal;
    }
    std::shared_ptr<const FrameSet> images;
    try {
      images = reader.frame(index)->images;
    } catch (const Error& fault) {
      first_fault = unreadable.empty() ? fault.what() : first_fault;
      unreadable.push_back(reader.entry(index).sequence);
    }
    written += images != nullptr ? write_set_pictures(*images, options.output) : 0;
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
                fmt::format("'{}' holds no pictures: they are recorded in mode \"frames\"", options.take));
  }
  fmt::print("{}: {} pictures of {} frames\n", options.output, written, selection.size());
  return 0;
}

void run_export(const ExportOptions& options) {
  take::TakeReader reader(options.take);
  const take::TakeInfo& info = reader.info();
  if (!info.closed) {
    fmt::print(stderr, "note: '{}' was not closed by its recorder; exporting the {} frames that are in it\n",
               options.take, info.frame_count);
  }
  const Selection selection = frames_in_range(reader, options.frames);
  const StopSignals signals;
  const int broken_off_by = options.format == "jsonl" ? export_signals(reader, selection, options, signals)
                            : options.format == "png" ? export_pictures(reader, selection, options, signals)
                                                      : export_meshes(reader, selection, options, signals);
  if (broken_off_by != 0) {
    signals.die_of(broken_off_by);
  }
}

}  // namespace

void add_export_command(CLI::App& app) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* command = app.add_subcommand(
      "export", "Write meshes (PLY, OBJ, GLB), signals (JSON lines) or pictures of a take");
  command->add_option("TAKE", options->take, "Take file")->required();
  command
      ->add_option(
          "--format", options->format,
          "ply, obj: camera frame, mm, x right, y down, z forward; glb: metres, y up; jsonl: one object per "
          "frame; png: the cameras' pictures, where they were recorded")
      ->required()
      ->check(CLI::IsMember({"ply", "obj", "glb", "jsonl", "png"}));
  command->add_option("--frames", options->frames, kFramesHelp);
  command->add_option("--level", options->level, "coarse: the tracked mesh; finest: the refined one")
      ->capture_default_str()
      ->check(CLI::IsMember({"coarse", "finest"}));
  command
      ->add_option("-o,--output", options->output,
                   "Folder for frame_%06d files (the number of the source's frame), or one file for one "
                   "frame; jsonl: a "
                   "file, - is standard output")
      ->required();
  command->callback([options] { run_export(*options); });
}

}  // namespace facet::tools
