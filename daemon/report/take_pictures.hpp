#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "facet/camera.hpp"
#include "mesh/mesh_frame.hpp"
#include "render/renderer.hpp"
#include "take/reader.hpp"

namespace facet::report {

constexpr std::array<std::uint8_t, 3> kPaper{20, 22,
                                             26};  ///< background of every picture that the tools make
constexpr std::array<std::uint8_t, 3> kInk{226, 228, 232};
constexpr std::array<std::uint8_t, 3> kFaintInk{150, 154, 162};

/// A frame's meshes in the camera frame, mm, at the finest level, with and without displacements.
struct FrameGeometry {
  mesh::Vertices coarse_mm;         ///< [3][finest vertex_count]
  Eigen::Matrix3Xf coarse_normals;  ///< [3][finest vertex_count] unit
  mesh::Vertices refined_mm;
  Eigen::Matrix3Xf refined_normals;
};

/// frame must have a mesh.
FrameGeometry geometry_of(const mesh::MeshFrame& frame);

/// The images that a take was made from, by Frame::sequence. Reads forward; of a video, asking for an earlier
/// frame than before opens the source anew. One thread.
class SourceImages {
 public:
  /// file: a video, or a take (NAME.take) that holds one camera's pictures. Throws Error(UnreadableInput)
  /// where it cannot be read.
  explicit SourceImages(std::filesystem::path file);

  /// None where the source has no such frame, ends before it or breaks.
  std::optional<Frame> at(std::uint64_t sequence);

 private:
  void open();
  std::optional<Frame> at_in_take(std::uint64_t sequence);

  std::filesystem::path file_;
  std::unique_ptr<take::TakeReader> take_;
  std::unique_ptr<Camera> camera_;
  Frame last_;
  bool has_last_ = false;
};

/// The given file where `given` is not empty; else the take's own pictures, or the video or take that it
/// names as its source; none where that is not a readable file. Throws Error(UnreadableInput) where the given
/// one cannot be read.
std::unique_ptr<SourceImages> open_source_images(const take::TakeInfo& info, const std::string& given);

/// A cut-out of the picture that a camera sees, scaled to a cell: the face with a margin.
struct Cell {
  CameraIntrinsics camera;  ///< of the cell
  float x_px = 0;           ///< the cut-out in the camera's picture; may reach outside
  float y_px = 0;
  float width_px = 0;
  float height_px = 0;
};

/// The cell that holds the given vertices with a margin of a tenth on each side. vertices_mm [3][any] camera
/// frame.
Cell cell_around(const mesh::Vertices& vertices_mm, const CameraIntrinsics& camera, int width_px,
                 int height_px);

/// The image's part in a cell.
render::Picture cell_picture(const Frame& image, const Cell& cell);

/// Renders a mesh with a linear colour per vertex. colours [3][vertex_count].
render::Picture render_colours(const render::Raycaster& caster, const mesh::Triangles& triangles,
                               const mesh::Vertices& colours, const CameraIntrinsics& camera,
                               const render::Picture& background);

/// Linear grey under a key light from the upper left, a weak fill and a little sky: for judging shape.
/// normals [3][vertex_count] camera frame. returns [3][vertex_count]
mesh::Vertices grey_shading(const Eigen::Matrix3Xf& normals);

/// render::normal_colour of each, linear. normals [3][vertex_count] camera frame. returns [3][vertex_count]
mesh::Vertices normal_colours(const Eigen::Matrix3Xf& normals);

/// A dark cell with a text in its middle.
render::Picture note(const std::string& text, int width_px, int height_px);

/// A text in the lower left corner of a sheet's cell.
void label_cell(render::Picture& sheet, int x_px, int bottom_px, const std::string& text);

/// Edges of the hierarchy's coarsest level that face the camera and are not hidden, over the image.
render::Picture draw_coarse_mesh(const mesh::MeshFrame& frame, const Cell& cell, render::Picture picture,
                                 float opacity);

/// The control vertices on refinable skin, camera frame: what cells are cut to.
mesh::Vertices face_vertices(const mesh::MeshFrame& frame);

/// A colour bar from 0 to a largest value, with its ends labelled. x, y: its upper left corner.
void draw_scale(render::Picture& picture, int x_px, int y_px, int width_px, const std::string& low,
                const std::string& high);

/// Every `frame_count / count`-th of the indices, the first and last included; all where there are fewer.
std::vector<std::int64_t> spread_evenly(const std::vector<std::int64_t>& indices, std::size_t count);

}  // namespace facet::report
