#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <variant>

#include "exports/export.hpp"

namespace facet::exports {

/// A file for each frame, `frame_%06d.EXTENSION`.
struct FrameFiles {
  void (*write)(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes axes);
  bool has_axes = true;      ///< false: the format has its own
  bool has_picture = false;  ///< shows ExportMesh::skin_png
};

/// One file for all frames.
struct Animation {
  std::unique_ptr<SequenceWriter> (*open)(const SequenceOptions& options, const SequenceFrame& first);
  bool in_expressions = false;  ///< of the coarse mesh, needs SequenceOptions::shapes
  bool compresses = false;      ///< takes SequenceOptions::compression
  bool has_no_node = false;     ///< takes SequenceOptions::space
  bool has_picture = false;     ///< shows ExportMesh::skin_png of the first frame
};

/// A map for each frame that has one, in a PictureFormat.
struct Maps {
  MapKind kind;
};

/// One text for all frames: a header, then a line for each, newlines included.
struct Lines {
  std::string (*header)();
  std::string (*line)(const mesh::MeshFrame& frame, std::int64_t index, const Timeline& timeline);
  bool in_time = false;  ///< the timeline is used, else it may be an empty one
};

/// A film for people to look at, in one file.
struct Film {};

/// The cameras' pictures as they were recorded.
struct CameraPictures {};

/// The sound beside the take, from the first frame on, in one file.
struct Sound {};

/// What `facet export` can write: a format is one row of export_formats().
struct ExportFormat {
  const char* name;
  const char* help;       ///< a clause for --format
  const char* extension;  ///< of its files, without dot; of maps and pictures: empty
  std::variant<FrameFiles, Animation, Maps, Lines, Sound, Film, CameraPictures> writes;

  bool is_one_file() const {
    return std::holds_alternative<Animation>(writes) || std::holds_alternative<Lines>(writes) ||
           std::holds_alternative<Sound>(writes) || std::holds_alternative<Film>(writes);
  }
};

/// In the order of the help.
std::span<const ExportFormat> export_formats();

/// What writes one mesh into a file of that extension; null where nothing does.
decltype(FrameFiles::write) mesh_writer_for(const std::filesystem::path& file);

}  // namespace facet::exports
