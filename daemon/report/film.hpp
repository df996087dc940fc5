#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "render/renderer.hpp"
#include "report/take_pictures.hpp"
#include "take/reader.hpp"

namespace facet::report {

/// What a part of a film shows.
enum class FilmPanel {
  Picture,  ///< what the camera saw
  Mesh,     ///< the same under the edges of the coarse mesh
  Grey,     ///< the refined mesh in grey under a light of the studio
  Skin,     ///< the refined mesh in the person's albedo under the light that was found
  Normals,  ///< the refined mesh's normals as colours
};
/// "picture", "mesh", "grey", "skin", "normals".
const char* to_string(FilmPanel panel);
/// From such names with commas between. Throws Error(Usage) that lists them.
std::vector<FilmPanel> parse_film_panels(const std::string& text);

/// A face at one moment.
struct FilmLook {
  mesh::Vertices vertices_mm;  ///< [3][any] camera frame
  CameraIntrinsics camera;     ///< of pictures of the same size
};

/// One cut-out for all of a film: what holds the face wherever it goes. One that followed the face would pump
/// with every expression. looks: at many moments, one at least; the cell's camera is the last one's.
Cell film_cell(const std::vector<FilmLook>& looks, int width_px, int height_px);

/// Draws a take's frames as a film's pictures: panels side by side, each 4 wide to 5 high, a line of text
/// below. One thread.
class FilmPainter {
 public:
  /// Reads up to 120 frames for what the film's camera must hold, and the last one for the albedo, as it was
  /// learned by then. Throws Error(UnreadableInput) from the reader, Error(NoFace) where no frame has a mesh.
  ///
  /// take, images  outlive it; images may be null
  /// frames        indices in the take, at least one
  /// height_px     of the panels; made even
  FilmPainter(take::TakeReader& take, const std::vector<std::int64_t>& frames, SourceImages* images,
              std::vector<FilmPanel> panels, int height_px);

  int width_px() const;   ///< of the film, even
  int height_px() const;  ///< likewise, the text's line included

  /// A frame without a mesh has the picture alone, and its state in the other panels' place. Throws
  /// Error(Usage) where the pictures have another size than those that the take was made from.
  ///
  /// text  of the line below
  render::Picture paint(const mesh::MeshFrame& frame, const std::string& text);

 private:
  std::vector<float> albedo_of(const mesh::MeshFrame& frame) const;
  Cell cell_of(const mesh::MeshFrame& frame) const;
  std::optional<Frame> image_of(const mesh::MeshFrame& frame) const;

  SourceImages* images_;
  std::vector<FilmPanel> panels_;
  Cell cell_;
  int width_px_ = 0;  ///< of the pictures that the take was made from
  int height_px_ = 0;
  std::uint64_t subject_ = 0;  ///< whose albedo_ is
  std::vector<float> albedo_;  ///< [vertex_count][3] linear RGB; empty: none was learned
};

}  // namespace facet::report
