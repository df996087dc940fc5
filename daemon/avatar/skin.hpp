#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "avatar/glb_document.hpp"
#include "avatar/retarget.hpp"
#include "mesh/mesh.hpp"

namespace facet::avatar {

/// A primitive of an avatar's mesh with ARKit's shapes: at rest, in the mesh's own space and unit.
struct Skin {
  std::string name;  ///< of the mesh and its material
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;  ///< unit; the file's, else of the triangles
  mesh::Triangles triangles;
  mesh::TextureCoordinates texture_coordinates;        ///< TEXCOORD_0, v up; empty where it has none
  std::vector<std::pair<int, mesh::Vertices>> shapes;  ///< index into mesh::kArkitNames, movement at weight 1
};

/// The primitives of the avatar's meshes that shapes move. Throws Error(UnreadableInput) where the document
/// is not sound or is compressed (Draco, meshopt, quantized positions), or holds more than kMostSkinValues.
std::vector<Skin> read_skins(const GlbDocument& glb, const Avatar& avatar);

/// Numbers of vertices and shapes of all skins together.
inline constexpr std::size_t kMostSkinValues = 100'000'000;

/// A person's face as the take's model has it, head frame, mm.
struct PersonShapes {
  mesh::Vertices neutral_mm;  ///< [3][vertex_count]
  mesh::Triangles triangles;
  std::vector<std::pair<int, mesh::Vertices>> shapes;  ///< as Skin::shapes
  mesh::Vertices skin_mm;  ///< points of the neutral face that an avatar should cover: skin, no eyes or mouth
};

/// Where an avatar's skin lies on a person's face, and how well.
struct Placement {
  float mm_per_unit = 1;                                         ///< size of the avatar's unit on the person
  Eigen::Matrix3f head_from_skin = Eigen::Matrix3f::Identity();  ///< turn
  Eigen::Vector3f translation_mm{0, 0, 0};
  int shape_count = 0;            ///< that both have
  float shape_distance_mm = 0;    ///< median, between where shapes are on the one and on the other
  float surface_distance_mm = 0;  ///< rms, of the skin's vertices that lie on the face
  float covered = 0;              ///< of PersonShapes::skin_mm, 0 to 1

  /// What takes the shapes' centres the rest of the way to each other, smooth between them: the avatar's face
  /// is another one. Movement at a point p of the head frame: shifts * (|p - centre| for each centre, 1, p).
  mesh::Vertices centres_mm;  ///< [3][shape_count]
  Eigen::Matrix3Xf shifts;    ///< [3][shape_count + 4]; empty: none

  /// [3][any] points of the skin in the head frame.
  mesh::Vertices to_head_mm(const mesh::Vertices& points) const;
};

/// A point of an avatar's skin belongs to the nearest point of the face where that is nearer than this and
/// their normals agree, at the person's size.
inline constexpr float kMostSkinDistance_mm = 10;
inline constexpr float kLeastNormalCosine = 0.5F;

/// Beyond these a placement is none.
inline constexpr int kFewestShapes = 6;
inline constexpr float kMostShapeDistance_mm = 15;
inline constexpr float kMostSurfaceDistance_mm = 5;
inline constexpr float kLeastCovered = 0.6F;

/// Places a skin on a face by a similarity: first the centres of the shapes that both have (the mean of where
/// a shape moves the surface, weighted with area and the movement's square) on each other, whatever the
/// avatar's unit, axes and nodes; then these and the nearest points of the surfaces together. Outliers of
/// either count little. What is left between the centres a smooth warp takes away (the biharmonic kernel,
/// with as much smoothing as the centres are unsure). Throws Error(Usage) saying why where a bound above is
/// not kept.
Placement place_skin(const Skin& skin, const PersonShapes& person);

/// Of several skins the one that covers the face best, with its placement. Throws Error(Usage): each skin's
/// fault where none can be placed, or that the one that fits has no texture coordinates.
std::pair<std::size_t, Placement> choose_skin(const std::vector<Skin>& skins, const PersonShapes& person);

/// A person's face, in the finest mesh of a take, as what lies under an avatar's skin. Immutable; any thread.
class FaceUnderSkin {
 public:
  /// The person's neutral face without displacements, head frame, mm. [3][vertex_count], [3][triangle_count]
  FaceUnderSkin(const mesh::Vertices& neutral_mm, const mesh::Triangles& triangles);
  ~FaceUnderSkin();
  FaceUnderSkin(const FaceUnderSkin&) = delete;
  FaceUnderSkin& operator=(const FaceUnderSkin&) = delete;

  struct Point {
    std::int32_t triangle = -1;    ///< -1: there is no face
    std::array<float, 3> weights;  ///< of its vertices
    float strength = 0;            ///< 0 to 1; fades to 0 where distance or normals reach their bound
  };
  /// The point of the face that belongs to a point of the skin, both head frame; normal: the skin's, unit.
  Point under(const Eigen::Vector3f& point_mm, const Eigen::Vector3f& normal) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::avatar
