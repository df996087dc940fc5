#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "render/renderer.hpp"
#include "render/strand_caster.hpp"
#include "simulation/light.hpp"
#include "simulation/look.hpp"
#include "simulation/scattering.hpp"
#include "simulation/shading.hpp"
#include "simulation/strands.hpp"

namespace facet::simulation {

/// What an actor that is not painted is lit from; all borrowed. The scene's first vertices are the head's.
struct LookScene {
  const Scene& scene;
  const render::Raycaster& surfaces;
  const HairStrands& hair;
  const render::StrandCaster& strands;  ///< the hair, in the scene's frame
  const Scattering* scattering;         ///< of the head's vertices; null: none
  const Eigen::VectorXf& oil;           ///< [head vertex_count] as in SkinMaps
};

/// Linear colour of the vertices marked, after a look: area lights with shadow rays; an ambient light that
/// folds and chin hide, one reflection of light between surfaces; diffusion below the skin; two lobes of
/// gloss; mirrors in the eyes. Each as far as the look has it. Runs on up to two threads.
/// seen     [vertex_count] 1 where a colour is wanted; what lies beside needs none
/// eye_mm   the camera that looks, in the frame of the scene
/// returns  [3][vertex_count], 0 where not seen
Eigen::Matrix3Xf shade_look(const LookScene& scene, const Lighting& lighting, const Look& look,
                            const std::vector<std::uint8_t>& seen, const Eigen::Vector3f& eye_mm);

/// Linear colour of the strands' points: hair after Kajiya and Kay [KK89], shadowed once a strand.
/// seen     [strand count] 1 where a colour is wanted
/// returns  [3][point_count]
Eigen::Matrix3Xf shade_strands(const LookScene& scene, const Lighting& lighting,
                               const std::vector<std::uint8_t>& seen, const Eigen::Vector3f& eye_mm);

}  // namespace facet::simulation
