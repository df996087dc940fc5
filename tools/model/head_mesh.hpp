#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"
#include "model/makehuman_data.hpp"

namespace facet::model {

/// What a vertex of the cut head belongs to.
enum class Part : std::uint8_t { Skin, MouthInterior, Socket, LeftEyeball, RightEyeball };

/// The head that is cut from MakeHuman's base mesh: face, ears and skull down to the jaw line and above the
/// nape, inner mouth, eye sockets and eyeballs; quads, manifold, open at the neck and along a slit at the
/// back of the skull where the texture's seam runs (both sides of the slit are copies of the same base
/// vertices).
struct HeadMesh {
  mesh::Quads quads;                             ///< [4][quad_count]
  std::vector<int> base_vertex;                  ///< [vertex_count] index in the base mesh
  std::vector<Part> part;                        ///< [vertex_count]; a seam vertex (lips, lids) is Skin
  std::vector<int> mirror;                       ///< [vertex_count] the vertex on the other side
  std::vector<Eigen::Vector2f> skin_uv;          ///< [vertex_count] texture coordinates in the skin pictures
  mesh::TextureCoordinates texture_coordinates;  ///< [2][vertex_count] one chart, upright, 0 to 1
  std::vector<std::uint8_t> on_boundary;         ///< [vertex_count]
  std::vector<int> lip_seam;                     ///< vertices between lips' skin and inner mouth
  std::vector<int> left_lid_seam;                ///< vertices between lids' skin and socket, subject's left
  std::vector<int> right_lid_seam;

  int vertex_count() const { return static_cast<int>(base_vertex.size()); }
  /// Vertices of one part, ascending.
  std::vector<int> vertices_of(Part wanted) const;
};

/// Cuts the head out of the base mesh along the texture's seams, which are edge loops. Throws
/// Error(UnreadableInput) where the base mesh is not the expected one.
HeadMesh cut_head(const MakeHumanMesh& base);

/// Millimetres in the head frame from base mesh decimetres: scaled by 1.10 (MakeHuman's eyes are 57.6 mm
/// apart, an adult's about 63 mm), origin in the middle between the base mesh's eyeballs.
struct HeadFrame {
  Eigen::Vector3d origin_dm;
  static constexpr double kMmPerDm = 110.0;

  Eigen::Matrix3Xd points_mm(const Eigen::Matrix3Xd& points_dm) const {
    return kMmPerDm * (points_dm.colwise() - origin_dm);
  }
};

/// Positions of the head's vertices in the base mesh, and the frame that puts its eyes' centre at the origin.
HeadFrame head_frame(const MakeHumanMesh& base, const HeadMesh& head);
Eigen::Matrix3Xd base_positions_mm(const MakeHumanMesh& base, const HeadMesh& head, const HeadFrame& frame);

/// Rings of quads around a set of vertices: 0 for the set itself, -1 beyond max_rings.
std::vector<int> ring_distance(const mesh::Quads& quads, int vertex_count, const std::vector<int>& from,
                               int max_rings);

/// Area of a vertex: a quarter of each quad around it.
Eigen::VectorXd vertex_areas(const mesh::Quads& quads, const Eigen::Matrix3Xd& positions);

}  // namespace facet::model
