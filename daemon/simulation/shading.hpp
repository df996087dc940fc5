#pragma once

#include <Eigen/Core>
#include <vector>

#include "mesh/mesh.hpp"
#include "render/renderer.hpp"
#include "simulation/light.hpp"
#include "simulation/props.hpp"

namespace facet::simulation {

/// Everything in front of the camera as one mesh, camera frame, mm.
struct Scene {
  mesh::Vertices vertices_mm;       ///< [3][vertex_count]
  Eigen::Matrix3Xf normals;         ///< [3][vertex_count] unit
  Eigen::Matrix3Xf albedo;          ///< [3][vertex_count] linear RGB
  std::vector<Material> materials;  ///< [vertex_count]
  Eigen::VectorXf openness;         ///< [vertex_count] 0 to 1; NaN: found by rays when shading
  mesh::Triangles triangles;

  /// Adds a surface whose positions and normals are given in the camera frame. openness: empty for NaN.
  void add(const mesh::Vertices& part_mm, const Eigen::Matrix3Xf& part_normals,
           const Eigen::Matrix3Xf& part_albedo, const std::vector<Material>& part_materials,
           const mesh::Triangles& part_triangles, const Eigen::VectorXf& part_openness);
  void clear();
};

/// Linear colour of every vertex that may be seen: [MD19 eq. 1] for the ambient or SH light, area
/// lights with shadow rays, highlights (GGX [WMLT07]) where asked for and always on eyes; 0 where
/// a vertex faces away. Face skin under SH light without highlights is exactly albedo * (l . SH(n)).
/// eye_mm: the camera that looks, in the frame of the scene
/// returns [3][vertex_count]
Eigen::Matrix3Xf shade_vertices(const Scene& scene, const render::Raycaster& caster, const Lighting& lighting,
                                bool highlights, const Eigen::Vector3f& eye_mm = Eigen::Vector3f::Zero());

}  // namespace facet::simulation
