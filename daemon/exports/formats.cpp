#include "exports/formats.hpp"

#include <array>

#include "exports/export_sequence.hpp"

namespace facet::exports {
namespace {

void write_upright_glb(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes /*axes*/) {
  write_glb(mesh, file);
}

std::string curves_line(const mesh::MeshFrame& frame, std::int64_t /*index*/, const Timeline& timeline) {
  return live_link_line(frame, timeline);
}

std::string json_line(const mesh::MeshFrame& frame, std::int64_t index, const Timeline& timeline) {
  const auto place = take::timecode_at(timeline.timecode, frame.timestamp_ns, timeline.rate_hz);
  return frame_json(frame, index, place ? take::to_text(*place) : "") + "\n";
}

const std::array kFormats = {
    ExportFormat{"ply", "a mesh for each frame, metres, y up (or --axes camera)", "ply",
                 FrameFiles{write_ply}},
    ExportFormat{"obj", "the same as text", "obj", FrameFiles{write_obj}},
    ExportFormat{"glb", "the same as glTF 2.0", "glb",
                 FrameFiles{.write = write_upright_glb, .has_axes = false, .has_picture = true}},
    ExportFormat{"glb-frames", "one animated GLB: every frame a morph target, the head's pose on the node",
                 "glb", Animation{.open = open_glb_frames, .compresses = true, .has_picture = true}},
    ExportFormat{
        "glb-expressions",
        "one animated GLB: the coarse mesh, the expressions as morph targets, eyes and head as nodes", "glb",
        Animation{
            .open = open_glb_expressions, .in_expressions = true, .compresses = true, .has_picture = true}},
    ExportFormat{"fbx", "the same as FBX, but in one mesh, centimetres", "fbx",
                 Animation{.open = open_fbx, .in_expressions = true, .has_picture = true}},
    ExportFormat{"usda", "the same as USD (UsdSkel), metres", "usda",
                 Animation{.open = open_usda, .in_expressions = true}},
    ExportFormat{"usda-frames",
                 "USD: one mesh with time samples of its vertices, the head's pose as its transform", "usda",
                 Animation{.open = open_usda_frames}},
    ExportFormat{"pc2", "a vertex cache and the OBJ that it is for, metres, y up", "pc2",
                 Animation{.open = open_pc2, .has_no_node = true}},
    ExportFormat{"mdd", "the same for programs that read MDD", "mdd",
                 Animation{.open = open_mdd, .has_no_node = true}},
    ExportFormat{"displacement", "a map for each frame: mm along the smooth surface's normal", "",
                 Maps{MapKind::Displacement}},
    ExportFormat{"normal", "a map for each frame: normals in the head frame", "",
                 Maps{MapKind::ObjectNormal}},
    ExportFormat{"tangent-normal", "a map for each frame: normals against the smooth surface", "",
                 Maps{MapKind::TangentNormal}},
    ExportFormat{"albedo", "a map whenever the albedo changed", "", Maps{MapKind::Albedo}},
    ExportFormat{"csv", "ARKit's 52 curves and angles in the columns of Live Link Face", "csv",
                 Lines{.header = live_link_header, .line = curves_line, .in_time = true}},
    ExportFormat{"jsonl", "one object per frame", "jsonl",
                 Lines{.header = [] { return std::string(); }, .line = json_line}},
    ExportFormat{"wav", "the sound beside the take from its first mesh on, with its timecode", "wav",
                 Sound{}},
    ExportFormat{"flac", "the same as FLAC, without timecode", "flac", Sound{}},
    ExportFormat{"mp4",
                 "a film: the camera's picture, the mesh in grey and in its skin, with the take's sound",
                 "mp4", Film{}},
    ExportFormat{"png", "the cameras' pictures, where they were recorded", "", CameraPictures{}},
};

}  // namespace

std::span<const ExportFormat> export_formats() {
  return kFormats;
}

decltype(FrameFiles::write) mesh_writer_for(const std::filesystem::path& file) {
  for (const ExportFormat& format : kFormats) {
    const auto* files = std::get_if<FrameFiles>(&format.writes);
    if (files != nullptr && file.extension() == std::string(".") + format.extension) {
      return files->write;
    }
  }
  return nullptr;
}

}  // namespace facet::exports
