#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <utility>
#include <vector>

#include "render/renderer.hpp"
#include "render/strand_caster.hpp"
#include "simulation/optics.hpp"

namespace facet::simulation {

/// What the rays of one picture meet: several through each pixel, and more where strands may be.
class PictureRays {
 public:
  /// Casts them. Surfaces and strands are in the camera's frame, at the times that the optics' rays have.
  PictureRays(const Optics& optics, const render::Raycaster& surfaces, const render::StrandCaster& strands,
              int rays_per_pixel);

  /// Of a mesh's vertices those whose colours are needed, and a ring of neighbours round them.
  /// returns [vertex_count] 0 or 1
  std::vector<std::uint8_t> seen_vertices(const mesh::Triangles& triangles, Eigen::Index vertex_count) const;
  /// Of strands given by their first points ([strand_count + 1]) those that are met. [strand_count] 0 or 1
  std::vector<std::uint8_t> seen_strands(const render::Strands& strands,
                                         const std::vector<std::int32_t>& first) const;

  /// Averages colours over the rays of each pixel; rays that meet nothing show the background.
  /// colours          [3][vertex_count] linear RGB
  /// strand_colours   [3][point_count]
  /// background       [3][width_px * height_px]
  /// returns          [3][width_px * height_px]
  Eigen::Matrix3Xf picture(const mesh::Triangles& triangles, const Eigen::Matrix3Xf& colours,
                           const render::Strands& strands, const Eigen::Matrix3Xf& strand_colours,
                           const Eigen::Matrix3Xf& background) const;

 private:
  struct Sample {
    std::int32_t pixel = 0;
    std::int32_t triangle = -1;
    std::int32_t segment = -1;
    Eigen::Vector2f barycentric{0, 0};  ///< of a segment its second point's weight and 0
    float share = 1;                    ///< of the pixel's rays
  };
  std::vector<std::vector<Sample>> rows_;  ///< [height_px] those that meet something
};

}  // namespace facet::simulation
