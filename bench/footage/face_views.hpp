#pragma once

#include <array>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "mesh/mesh_frame.hpp"
#include "render/renderer.hpp"

namespace facet::footage {

/// One picture of a face, by the name of its kind.
struct FaceView {
  std::string kind;
  render::Picture picture;  ///< [side_px][side_px]
};

/// What a recogniser of faces is shown of one frame, every picture the same square round the face's skin:
/// "photo", the image; "cut", the image where the mesh covers it; "grey", the refined mesh under a key light;
/// and, where the albedo is learned, "albedo", the refined mesh in it, and "lit", the albedo under the
/// frame's own light [MD19 eq. 1]. Where there is nothing, pictures of a mesh are dark.
///
/// frame    with a mesh
/// image    the frame's image
/// side_px  of the square; 8 at least
/// Any thread.
std::vector<FaceView> face_views(const mesh::MeshFrame& frame, const Frame& image, int side_px);

/// Colours of an albedo under a light [MD19 eq. 1], linear; albedo and what it returns [3][vertex_count],
/// normals [3][vertex_count] unit, camera frame. Any thread.
mesh::Vertices lit_colours(const mesh::Vertices& albedo, const Eigen::Matrix3Xf& normals,
                           const std::array<float, 9>& lighting);

}  // namespace facet::footage
