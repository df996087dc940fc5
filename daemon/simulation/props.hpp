#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"
#include "simulation/anatomy.hpp"
#include "simulation/performance.hpp"
#include "simulation/skin.hpp"

namespace facet::simulation {

/// How a surface answers light beyond its albedo.
enum class Material : std::uint8_t { Skin, Hair, Eye, Tooth, Cloth, Frame };

/// A coloured surface. Which frame its vertices are in stands where it is used; mm.
struct Surface {
  mesh::Vertices vertices_mm;       ///< [3][vertex_count]
  Eigen::Matrix3Xf albedo;          ///< [3][vertex_count] linear RGB
  std::vector<Material> materials;  ///< [vertex_count]
  mesh::Triangles triangles;
};

/// An eyeball: centre and radius in the head frame.
struct Eyeball {
  Eigen::Vector3f centre_mm{0, 0, 0};
  float radius_mm = 0;
};

/// A ball with sclera, iris and pupil that looks along +z, around the origin.
Surface make_eyeball(float radius_mm, const Eigen::Vector3f& iris, std::uint64_t seed);

/// Rotation of an eyeball for a gaze; head frame.
Eigen::Matrix3f gaze_rotation(const Gaze& gaze);

/// One row of teeth behind the lips, head frame. upper: fixed to the skull, else to the jaw.
Surface make_teeth(const Anatomy& anatomy, bool upper);

/// Neck, shoulders and clothes below the head, head frame of the resting pose. Rows of constant height, top
/// first; hold[v] says how much a vertex follows the head (1) or the body (0).
struct Torso {
  Surface surface;
  std::vector<float> hold;
};
Torso make_torso(const Anatomy& anatomy, const Complexion& complexion, std::uint64_t seed);

/// Spectacles: two rims, bridge and temples, head frame; no lenses.
Surface make_glasses(const Anatomy& anatomy, std::uint64_t seed);

}  // namespace facet::simulation
