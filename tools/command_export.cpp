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
#include "pipeline/frame_range.hpp"
#include "progress.hpp"
#include "take/export.hpp"
#include "take/output_file.hpp"
#include "take/reader.hpp"

namespace facet::tools {
namespace {

struct ExportOptions {
  std::string take;
  std::string format;
  std::string frames;
  std::string level = "finest";
  std::string output;
};

/// Frames [first, end) of a take.
struct Selection {
  std::int64_t first = 0;
  std::int64_t end = 0;

  std::uint64_t size() const { return static_cast<std::uint64_t>(end - first); }
};

Selection select_frames(const take::TakeReader& reader, const std::string& text) {
  const pipeline::FrameRange range = pipeline::parse_frame_range(text);
  const auto count = static_cast<std::uint64_t>(reader.frame_count());
  const Selection selection{static_cast<std::int64_t>(std::min(range.first, count)),
                            static_cast<std::int64_t>(std::min(range.end, count))};
  if (selection.first >= selection.end) {
    throw Error(ErrorKind::Usage,
                count == 0 ? fmt::format("take '{}' has no frames", reader.info().file.string())
                           : fmt::format("--frames {} selects nothing: the take has frames 0 to {}", text,
                                         count - 1));
  }
  return selection;
}

take::MeshFormat mesh_format(const std::string& name) {
  return name == "ply"   ? take::MeshFormat::Ply
         : name == "obj" ? take::MeshFormat::Obj
                         : take::MeshFormat::Glb;
}

/// "3, 7-9" for the sorted indices 3, 7, 8, 9.
std::string ranges_text(const std::vector<std::int64_t>& indices) {
  std::string text;
  for (std::size_t i = 0; i < indices.size();) {
    std::size_t last = i;
    while (last + 1 < indices.size() && indices[last + 1] == indices[last] + 1) {
      ++last;
    }
    text += fmt::format("{}{}", text.empty() ? "" : ", ", indices[i]);
    text += last > i ? fmt::format("-{}", indices[last]) : "";
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

void export_meshes(take::TakeReader& reader, const Selection& selection, const ExportOptions& options) {
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
  std::vector<std::int64_t> without_mesh;
  for (std::int64_t index = selection.first; index < selection.end; ++index) {
    const auto frame = reader.frame(index);
    if (take::has_mesh(*frame)) {
      take::build_export_mesh(*frame, level, mesh);
      const std::string name = fmt::format("frame_{:06}.{}", index, take::extension(format));
      take::write_mesh(format, mesh, one_file ? output : output / name);
    } else {
      without_mesh.push_back(index);
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
}

void export_signals(take::TakeReader& reader, const Selection& selection, const ExportOptions& options) {
  const bool to_standard_output = options.output == "-";
  std::unique_ptr<take::OutputFile> file;
  if (!to_standard_output) {
    file = std::make_unique<take::OutputFile>(options.output);
  }
  Progress progress("Exporting", selection.size());
  for (std::int64_t index = selection.first; index < selection.end; ++index) {
    const std::string line = take::frame_json(*reader.frame(index), index) + "\n";
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
}

void run_export(const ExportOptions& options) {
  take::TakeReader reader(options.take);
  const take::TakeInfo& info = reader.info();
  if (!info.closed) {
    fmt::print(stderr, "note: '{}' was not closed by its recorder; exporting the {} frames that are in it\n",
               options.take, info.frame_count);
  }
  const Selection selection = select_frames(reader, options.frames);
  if (options.format == "jsonl") {
    export_signals(reader, selection, options);
  } else {
    export_meshes(reader, selection, options);
  }
}

}  // namespace

void add_export_command(CLI::App& app) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* command =
      app.add_subcommand("export", "Write meshes (PLY, OBJ, GLB) or signals (JSON lines) of a take");
  command->add_option("TAKE", options->take, "Take file")->required();
  command
      ->add_option(
          "--format", options->format,
          "ply, obj: camera frame, mm, x right, y down, z forward; glb: metres, y up; jsonl: one object per "
          "frame")
      ->required()
      ->check(CLI::IsMember({"ply", "obj", "glb", "jsonl"}));
  command->add_option("--frames", options->frames,
                      "A:B, the frames from A up to B without B, counted from 0");
  command->add_option("--level", options->level, "coarse: the tracked mesh; finest: the refined one")
      ->capture_default_str()
      ->check(CLI::IsMember({"coarse", "finest"}));
  command
      ->add_option(
          "-o,--output", options->output,
          "Folder for frame_%06d files, or one file for one frame; jsonl: a file, - is standard output")
      ->required();
  command->callback([options] { run_export(*options); });
}

}  // namespace facet::tools
