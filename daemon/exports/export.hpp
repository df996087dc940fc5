#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "mesh/mesh_frame.hpp"
#include "take/reader.hpp"

namespace facet::exports {

enum class MeshLevel { Coarse, Finest };

/// Frame of reference of an ExportMesh.
enum class MeshSpace {
  Camera,  ///< mm, x right, y down, z forward
  Head,    ///< mm, x to the subject's left, y up, z out of the face
};

/// One frame as a mesh to write.
struct ExportMesh {
  mesh::Vertices vertices_mm;                    ///< [3][vertex_count]
  Eigen::Matrix3Xf normals;                      ///< [3][vertex_count] unit length
  mesh::Triangles triangles;                     ///< counter-clockwise from outside
  mesh::TextureCoordinates texture_coordinates;  ///< [2][vertex_count] u right, v up
  mesh::Vertices albedo;                         ///< [3][vertex_count] linear RGB; empty: not learned yet
  std::shared_ptr<const std::vector<std::uint8_t>>
      skin_png;                         ///< the albedo as encode_skin makes it; null: none
  std::vector<float> displacements_mm;  ///< [vertex_count]; 0 at level Coarse or where not refined
  std::vector<float> confidence;        ///< [vertex_count]; 0 where not refined
};

/// Builds the mesh of a frame that has one, without skin_png. Buffers in `out` are reused.
void build_export_mesh(const mesh::MeshFrame& frame, MeshLevel level, MeshSpace space, ExportMesh& out);

/// Axes and unit of a mesh that is a file of its own.
enum class MeshAxes {
  Upright,  ///< metres, x to the picture's right, y up, z towards the camera: as in every other format
  Camera,   ///< mm, x right, y down, z forward: the numbers as they are
};
/// The same in words.
const char* words_of(MeshAxes axes);

/// Writers of meshes in the camera frame (MeshSpace::Camera). Each writes a temporary file beside `file` and
/// renames it, so that no reader meets half a file and an interrupted export leaves the earlier one. Throw
/// Error(Storage) naming the file.
///
/// PLY: binary little-endian; x y z, nx ny nz, s t, red green blue (sRGB of the albedo; 200 200 200 before
/// it is learned), displacement_mm, confidence.
void write_ply(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes axes);
/// OBJ: v with colour appended (sRGB of the albedo, 0 to 1), vt, vn.
void write_obj(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes axes);
/// GLB (glTF 2.0), which knows MeshAxes::Upright alone; NORMAL, TEXCOORD_0, _DISPLACEMENT_MM, _CONFIDENCE;
/// the albedo as a texture where the mesh has skin_png, else as COLOR_0 (linear).
void write_glb(const ExportMesh& mesh, const std::filesystem::path& file);

/// When the frames of a sequence are. At a constant rate the frames' numbers in the source are its clock:
/// number n is at (n - sequences.front()) / rate_hz seconds. At a varying one each frame has its own time.
struct Timeline {
  double rate_hz = 30;                   ///< on average where it varies
  std::vector<std::uint64_t> sequences;  ///< of the frames with a mesh that will be written, rising
  std::vector<double> times_s;  ///< [sequences.size()] from 0, rising, of a varying rate; empty: constant
  take::TakeTimecode timecode;  ///< of formats that name it: by the frames' timestamps
  std::int64_t first_ns = 0;    ///< the first frame's timestamp
  double deviation_s = 0;       ///< the most that a frame's media time is beside its number over the rate
};

/// The timeline of frames of a take. entries: those to write, in their order, at least one. The rate is that
/// between the first and the last, a usual one where it can't be told from it; 30 Hz where there is one frame
/// alone. It is constant where every media time is within half a frame of its number's. Throws
/// Error(UnreadableInput) naming `take` and the frame where numbers or times don't rise.
Timeline make_timeline(std::span<const take::FrameEntry> entries, const std::filesystem::path& take);

/// The timecode of the first frame, where it is known.
std::optional<take::TimecodePlace> start_timecode(const Timeline& timeline);

/// Seconds of a number of the source since the timeline's first. sequence: from the timeline's first to its
/// last; one that is not on it lies evenly between its neighbours.
double time_s(const Timeline& timeline, std::uint64_t sequence);

/// The shapes of a person's expressions, head frame, mm: what the take's coarse meshes were made of.
struct ExpressionShapes {
  std::vector<std::string> names;
  mesh::Vertices neutral_mm;              ///< [3][vertex_count] of level 0
  std::vector<mesh::Vertices> deltas_mm;  ///< [names.size()] likewise
  /// Vertices of the left and of the right eyeball, rising, no triangle of which has another vertex; empty:
  /// they are no pieces of their own.
  std::array<std::vector<std::int32_t>, 2> eyeballs;
};

/// Finds the eyeballs: of the pieces of a mesh those of `is_eye` vertices alone, the largest on either side.
/// vertices_mm  [3][vertex_count] head frame: x > 0 is the left one
/// is_eye       [n] of the first n vertices, 1 where one is of an eye; those behind go with their triangles
std::array<std::vector<std::int32_t>, 2> find_eyeballs(const mesh::Vertices& vertices_mm,
                                                       const mesh::Triangles& triangles,
                                                       std::span<const std::uint8_t> is_eye);

/// How the arrays of a GLB file are encoded.
enum class GlbCompression {
  None,
  Meshopt,  ///< EXT_meshopt_compression: vertices up to 0.002 mm away (expressions 0.004), normals 0.05
            ///< degrees
};

struct SequenceOptions {
  std::filesystem::path file;
  Timeline timeline;
  /// Of the caches that have no node to carry the head's pose (PC2, MDD): whether the pose is in the
  /// vertices.
  MeshSpace space = MeshSpace::Camera;
  ExpressionShapes shapes;                            ///< of formats made of expressions (Animation)
  GlbCompression compression = GlbCompression::None;  ///< of GlbFrames and GlbExpressions
};

/// One frame of a sequence.
struct SequenceFrame {
  std::uint64_t sequence = 0;                                          ///< its number in the source
  ExportMesh mesh;                                                     ///< MeshSpace::Head
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();  ///< mm
  std::vector<float> expression;
};

/// Writes frames into one file as they come, with memory for a few of them. The file appears whole when
/// commit returns, or not at all. Errors: Error(Storage) naming the file; Error(Usage) naming the frame where
/// its mesh is another one than the first frame's, or where the format can't hold so much. One thread.
class SequenceWriter {
 public:
  SequenceWriter() = default;
  SequenceWriter(const SequenceWriter&) = delete;
  SequenceWriter& operator=(const SequenceWriter&) = delete;
  virtual ~SequenceWriter() = default;

  /// Frames come in the order of the timeline, all of them.
  virtual void add(const SequenceFrame& frame) = 0;
  virtual void commit() = 0;
};

/// The writers of the formats that hold many frames in one file; `first` is the first frame that will be
/// added. Vertices and triangles are in the order of ExportMesh in every format. Frame and unit: metres, y up
/// (docs/exports.md).
std::unique_ptr<SequenceWriter> open_pc2(const SequenceOptions& options, const SequenceFrame& first);
std::unique_ptr<SequenceWriter> open_mdd(const SequenceOptions& options, const SequenceFrame& first);
std::unique_ptr<SequenceWriter> open_usda_frames(const SequenceOptions& options, const SequenceFrame& first);
std::unique_ptr<SequenceWriter> open_glb_frames(const SequenceOptions& options, const SequenceFrame& first);
/// Of the neutral face and its shapes: SequenceOptions::shapes, and the mesh of `first` at level Coarse. Only
/// GLB has the eyeballs as nodes of their own; its vertices without them are in the same order.
std::unique_ptr<SequenceWriter> open_glb_expressions(const SequenceOptions& options,
                                                     const SequenceFrame& first);
std::unique_ptr<SequenceWriter> open_usda(const SequenceOptions& options, const SequenceFrame& first);
/// Keeps the curves in memory: 16 bytes a frame for each expression. Centimetres.
std::unique_ptr<SequenceWriter> open_fbx(const SequenceOptions& options, const SequenceFrame& first);

/// Curves in the columns of Live Link Face's recordings: Timecode, BlendShapeCount (61), 52 values, angles in
/// radians (mesh::live_link_rotations). Frames without a mesh have a line of zeros.
std::string live_link_header();
/// One line, with its newline. The timecode is that of Timeline::timecode, counted on where it is not known;
/// where a take has none, it counts from 0 at the timeline's first frame, at its rate rounded to a whole
/// number of frames a second; at a varying rate its seconds are those of time_s, and the frame has
/// thousandths.
std::string live_link_line(const mesh::MeshFrame& frame, const Timeline& timeline);

/// Pictures of a frame in its texture coordinates, u right and v up.
enum class MapKind {
  Displacement,   ///< mm along the smooth surface's normal
  ObjectNormal,   ///< unit normal in the head frame
  TangentNormal,  ///< unit normal against the smooth surface: x along u, y along v, z along its normal
  Albedo,         ///< linear RGB
};
enum class PictureFormat {
  Png,  ///< 16 bits a channel, of 0 to 1 for: 0.5 + displacement / (2 * kDisplacementRange_mm); 0.5 + 0.5
        ///< normal; albedo in sRGB
  Exr,  ///< 32-bit float, the values themselves
};
inline constexpr float kDisplacementRange_mm = 10.0F;

/// A map's pixels, top row first. The edges of what the triangles cover are carried on for 8 pixels; beyond,
/// all is 0.
struct MapPicture {
  int size_px = 0;
  int channels = 0;
  std::vector<float> values;  ///< [size_px][size_px][channels]
};

/// Another mesh for which the take's maps are baked: an avatar's skin.
struct MapLayout {
  mesh::Triangles triangles;
  mesh::TextureCoordinates texture_coordinates;  ///< [2][vertex_count]
  mesh::Vertices vertices_mm;                    ///< [3][vertex_count] where it lies, head frame
  Eigen::Matrix3Xf normals;                      ///< [3][vertex_count] unit

  /// Where a point of it lies on the take's finest mesh.
  struct Place {
    std::int32_t triangle = -1;      ///< -1: nowhere
    std::array<float, 3> weights{};  ///< of the triangle's vertices
    float strength = 1;              ///< 0 to 1, what of the relief is put there
  };
  std::function<Place(std::int32_t triangle, const std::array<float, 3>& weights)> place;
};

/// Bakes vertices' values into pictures. Where the pixels lie in the triangles is found once for each mesh.
/// One thread.
class MapBaker {
 public:
  /// size_px: width and height, 16 to 16384. layout: whose texture coordinates the maps are in; null: the
  /// take's own. With one, displacements are those of the take, mm at the person's size, and the tangent
  /// normal is what the take's relief makes of the layout's own; ObjectNormal is not there
  /// (Error(Internal)). All frames must be of one hierarchy then.
  explicit MapBaker(int size_px, std::shared_ptr<const MapLayout> layout = nullptr);
  ~MapBaker();
  MapBaker(const MapBaker&) = delete;
  MapBaker& operator=(const MapBaker&) = delete;

  /// The frame has a mesh; for Albedo it has one.
  const MapPicture& bake(const mesh::MeshFrame& frame, MapKind kind);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A map of the albedo as the picture that mesh files show: PNG, 8 bits a channel, sRGB.
std::vector<std::uint8_t> encode_skin(const MapPicture& albedo);

/// Writes a map, whole or not at all. Throws Error(Storage) naming the file.
void write_map(const MapPicture& picture, MapKind kind, PictureFormat format,
               const std::filesystem::path& file);

/// One line of the jsonl export, without the newline: index, sequence, timestamp_ns, media_time_ns, timecode
/// ("HH:MM:SS:FF" as given, null where it is empty), state,
/// degraded, camera, camera_from_head, expression, expression_confidence, avatar_values, model_weights,
/// identity, lighting, landmarks_px, reprojection_px, photometric_rms, stage_ms. Without a mesh
/// camera_from_head is null and the lists are empty.
std::string frame_json(const mesh::MeshFrame& frame, std::int64_t index, const std::string& timecode = {});

}  // namespace facet::exports
