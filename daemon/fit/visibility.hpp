#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "capture/rig.hpp"
#include "mesh/mesh.hpp"

namespace facet::fit {

/// Distance along z from every pixel of a lens to the nearest triangle; infinity where there is none. Without
/// the lens's distortion.
class DepthBuffer {
 public:
  /// seen  [3][vertex_count] in the frame of the lens, mm
  void draw(const capture::Lens& lens, const Eigen::Matrix3Xf& seen, const mesh::Triangles& triangles);
  /// Of the nearest pixel; 0 outside.
  float at(float x, float y) const;

 private:
  void fill(const std::array<Eigen::Vector3f, 3>& corner);

  int width_ = 0;
  int height_ = 0;
  std::vector<float> depth_;
};

/// Which vertices a lens sees: in front of it, in its picture, turned towards it and behind no other part of
/// the mesh (drawn with `margin_mm` to spare), and `rim_px` away from where the mesh ends or hides itself:
/// there a flow mixes what moves differently. [vertex_count] 0 or 1.
void find_visible(const capture::Lens& lens, const mesh::Vertices& vertices_mm,
                  const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles, float margin_mm,
                  float rim_px, std::vector<std::uint8_t>& visible);

}  // namespace facet::fit
