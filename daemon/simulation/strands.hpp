#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh.hpp"
#include "render/strand_caster.hpp"
#include "simulation/anatomy.hpp"
#include "simulation/skin_maps.hpp"

namespace facet::simulation {

/// Where hairs and the red of the lips begin: lines of the resting face, head frame, mm; of each eye and brow
/// from the nose outwards. Read off a model's landmark map; what it lacks is left out.
struct FaceLines {
  std::array<std::vector<Eigen::Vector3f>, 2> lid_upper;  ///< the margin, corner to corner
  std::array<std::vector<Eigen::Vector3f>, 2> lid_lower;
  std::array<std::vector<Eigen::Vector3f>, 2> brow_upper;  ///< the brow's upper edge
  std::array<std::vector<Eigen::Vector3f>, 2> brow_lower;
  std::vector<Eigen::Vector3f> lips;  ///< once round their outer edge
};
FaceLines find_face_lines(const face::FaceModel& model, const mesh::Vertices& neutral_mm);

/// How far a point belongs to the lips inside an outline, 0 to 1, [vertex_count]; models differ in what
/// they call lips.
Eigen::VectorXf lip_cover(const std::vector<Eigen::Vector3f>& outline, const mesh::Vertices& resting_mm);

/// A resting head to grow hair on: what belongs to the finest mesh, head frame.
struct Scalp {
  const mesh::Vertices& vertices_mm;
  const Eigen::Matrix3Xf& normals;
  const mesh::Triangles& triangles;
  const SkinZones& zones;
  const Eigen::VectorXf& hair;  ///< [vertex_count] 0 bare to 1 full hair
};

/// An actor's single hairs. Each is rooted in a triangle and keeps its form in the frame of the skin there.
struct HairStrands {
  std::vector<std::int32_t> triangle;        ///< [strand_count] of the root
  std::vector<Eigen::Vector2f> barycentric;  ///< [strand_count] of the root
  std::vector<Eigen::Vector3f> albedo;       ///< [strand_count] linear RGB
  std::vector<std::int32_t> first{0};     ///< [strand_count + 1] first point; the last is the points' number
  std::vector<Eigen::Vector3f> local_mm;  ///< [point_count] two axes along the skin, one off it
  std::vector<float> radius_mm;           ///< [point_count]

  std::size_t count() const { return triangle.size(); }
};

/// Grows brows, lashes, the beard that the person has, and hair of the head.
HairStrands grow_strands(const Scalp& scalp, const Anatomy& anatomy, const FaceLines& lines,
                         const Person& person, std::uint64_t seed);

/// The strands on a head that has moved: its vertices and unit normals, any frame. Segments come in the
/// strands' order, one less each than points.
render::Strands place_strands(const HairStrands& hair, const mesh::Vertices& vertices_mm,
                              const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles);

}  // namespace facet::simulation
