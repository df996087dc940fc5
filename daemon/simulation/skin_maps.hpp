#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "simulation/anatomy.hpp"
#include "simulation/chromophores.hpp"
#include "simulation/look.hpp"
#include "simulation/skin.hpp"

namespace facet::simulation {

/// What an actor's skin is coloured by, and what lies over it. All [vertex_count] of the finest mesh.
struct SkinMaps {
  Eigen::VectorXf melanin;  ///< part of the epidermis, 0 to 1
  Eigen::VectorXf blood;    ///< part of the dermis at rest, 0 to 1
  Eigen::VectorXf cover;    ///< 0 skin to 1: hair, mouth, sockets, make-up
  Eigen::Matrix3Xf over;    ///< [3][vertex_count] linear RGB of what covers
  Eigen::VectorXf oil;      ///< how strongly the skin shines, about 1
};

/// How a person of a skin type is coloured: hair, iris and beard are those of the type.
struct Person {
  Complexion complexion;  ///< skin: its albedo where nothing is special
  Chromophores skin;      ///< the same as pigments
  float freckles = 0;     ///< 0 none to 1 many
  float beard_mm = 0;     ///< length of its hairs; 0 none
  bool makeup = false;
};
Person make_person(const Look& look, std::uint64_t seed);

/// Spreads a person's pigments over the resting face: blotches, freckles, moles; redder cheeks, nose, ears
/// and lips, darker lids, as [JSB10] measured; brows, lash lines and stubble only where the look has no
/// strands. Arguments as of paint_albedo.
SkinMaps map_skin(const Anatomy& anatomy, const Person& person, const Look& look, const SkinZones& zones,
                  const Eigen::Matrix3Xf& resting_mm, std::uint64_t seed);

/// The albedo of maps with the blood multiplied by blood_flow: [vertex_count], or empty for 1 everywhere.
/// returns [3][vertex_count] linear RGB
Eigen::Matrix3Xf skin_albedo(const SkinMaps& maps, const Eigen::VectorXf& blood_flow);

}  // namespace facet::simulation
