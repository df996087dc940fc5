#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "simulation/anatomy.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {

/// Where a resting vertex lies, as soft weights 0 to 1; all [vertex_count] of the finest mesh.
struct SkinZones {
  Eigen::VectorXf skin;   ///< face skin
  Eigen::VectorXf lips;   ///< red of the lips
  Eigen::VectorXf eye;    ///< lids' inner side and sockets
  Eigen::VectorXf mouth;  ///< inner mouth
  Eigen::VectorXf
      openness;  ///< part of the sky that a point sees over its horizon: small in nostrils and folds
};

/// An actor's colours, linear RGB.
struct Complexion {
  Eigen::Vector3f skin{0, 0, 0};
  Eigen::Vector3f hair{0, 0, 0};
  Eigen::Vector3f iris{0, 0, 0};
  float beard = 0;  ///< 0 none to 1 strong stubble
};

/// Light to dark skins, blond to black hair.
Complexion make_complexion(std::uint64_t seed);

/// How much a point of the brow is covered by hair, 0 to 1: a band that narrows outwards, made of slanting
/// strands. index: the brow's, as in Anatomy.
float brow_cover(const Anatomy& face, std::size_t index, const Eigen::Vector3f& at_mm, const Noise& strands);

/// Where a beard grows, 0 to 1: upper lip, chin, jaw and lower cheeks.
float beard_zone(const Anatomy& face, const Eigen::Vector3f& at_mm);

/// How far a point lies above the hairline, mm; negative on the face, the ears and the neck. skin:
/// SkinZones::skin there: the face skin is free of hair, for hair would hide it from every method.
float above_hairline_mm(const Anatomy& anatomy, const Eigen::Vector3f& point_mm, float skin);

/// Paints the resting face: tone with the model's mean albedo as its pattern, redness, blotches, freckles,
/// stubble, brows, lips, lid margins, hair. [3][vertex_count] linear RGB.
/// mean_albedo   [3][vertex_count] of the face model, pushed to the finest mesh
Eigen::Matrix3Xf paint_albedo(const Anatomy& anatomy, const Complexion& complexion, const SkinZones& zones,
                              const Eigen::Matrix3Xf& resting_mm, const Eigen::Matrix3Xf& mean_albedo,
                              std::uint64_t seed);

}  // namespace facet::simulation
