#pragma once

// Private to this room: a lamp that fired while a head was still.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <optional>
#include <span>
#include <vector>

#include "light/head_visibility.hpp"
#include "mesh/mesh.hpp"
#include "person/skin_texels.hpp"

namespace facet::person {

/// The surface that texels lie on.
struct LitSurface {
  const SkinTexels& texels;
  const mesh::Vertices& vertices_mm;  ///< [3][vertex_count] head frame
  const Eigen::Matrix3Xf& normals;    ///< [3][vertex_count] unit
  const mesh::Triangles& triangles;
};

/// One picture of the head under a lamp.
struct LitPicture {
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();
  Eigen::ArrayXf brightness;  ///< [texel_count] linear
  Eigen::ArrayXf weight;      ///< [texel_count] 0: it or the dark one does not show the texel
};

/// A small lamp, and how its pictures show the skin: I = r I_dark + s E rho with
///   E = V clamped(n . l) (d_0 / d)^2
/// where l and d are direction and distance of the lamp from the texel, d_0 its distance from the middle of
/// the face and V what it sees of the texel past the head.
struct BurstLamp {
  Eigen::Vector3f place_mm;     ///< camera frame
  float reference_mm = 1;       ///< d_0
  std::vector<float> exposure;  ///< [picture] r
  std::vector<float> strength;  ///< [picture] s
  /// Rms of what is left, no more than Tukey's bound each, over that of I - r I_dark.
  float unexplained = 1;
};

/// What a lamp gives the texels of a picture.
struct LampShading {
  Eigen::ArrayXf shading;           ///< [texel_count] E
  Eigen::ArrayXf slope_u, slope_v;  ///< [texel_count] its change with a displacement's rise, 1/mm
  /// [texel_count] 0 where skin mirrors the lamp, in its shadow and at the shadow's edge, 1 well away
  Eigen::ArrayXf trust;
};

/// Finds a lamp from pictures of a face whose albedo is known about: a search over directions and distances
/// (300 mm to 2 m), then steps that halve.
///
/// pictures          of the still head, at least one
/// dark              [texel_count] I_dark
/// albedo            [texel_count] rho
/// usual_brightness  of the pictures
/// Nothing where the pictures show no lamp. A second or two for six pictures and 768 texels.
std::optional<BurstLamp> find_burst_lamp(const LitSurface& surface, const light::HeadVisibility& visibility,
                                         std::span<const LitPicture> pictures, const Eigen::ArrayXf& dark,
                                         const Eigen::ArrayXf& albedo, float usual_brightness);

/// What a lamp gives all texels of one picture, E and how it changes with the relief, before its strength.
LampShading lamp_shading(const LitSurface& surface, const BurstLamp& lamp,
                         const Eigen::Isometry3f& camera_from_head);

}  // namespace facet::person
