#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"
#include "model/head_mesh.hpp"
#include "render/renderer.hpp"

namespace facet::model {

/// Bits of face::Region per vertex of the cut head. mean_mm [3][vertex_count] its mean shape in the head
/// frame with the origin between the eyes; ear [vertex_count] 1 on the ears.
std::vector<std::uint8_t> find_regions(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                                       const std::vector<std::uint8_t>& ear);

/// Mean of the skins' colours at every vertex, in linear light; eyeballs get the colours of sclera and iris.
/// returns [3][vertex_count] linear RGB
mesh::Vertices mean_albedo(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm,
                           const std::vector<render::Picture>& skins);

/// The colours of sclera and iris at the eyeballs' vertices of albedo, [3][vertex_count] linear RGB.
void paint_eyeballs(const HeadMesh& head, const Eigen::Matrix3Xd& mean_mm, mesh::Vertices& albedo);

}  // namespace facet::model
