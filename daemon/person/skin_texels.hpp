#pragma once

// Private to this room: the texels of a chart that hold skin.

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "mesh/mesh.hpp"
#include "person/texel_grid.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {

/// Where the skin of a chart's texels lies.
struct SkinTexels {
  /// surface_mm  [3][vertex_count] head frame
  SkinTexels(const TextureChart& chart, const mesh::Triangles& triangles, const mesh::Vertices& surface_mm);

  Eigen::Index count() const { return grid.count(); }
  /// [height][width] of values [count]; 0 where there is no skin.
  cv::Mat image(const Eigen::ArrayXf& values) const;

  TexelGrid grid;
  Eigen::Matrix3Xi corners;       ///< [3][count] vertices
  Eigen::Matrix3Xf shares;        ///< [3][count] their barycentric weights
  Eigen::Matrix3Xf normals;       ///< [3][count] head frame, unit
  Eigen::Matrix3Xf positions_mm;  ///< [3][count] against the middle of the vertices
  /// [3][count] what a displacement that rises by 1 mm to the next texel to the right (below) takes from the
  /// normal: the gradient of the chart's coordinate, 1/mm; 0 where a neighbour is missing.
  Eigen::Matrix3Xf along_u, along_v;
  double texel_mm = 1;  ///< median distance of neighbours
};

}  // namespace facet::person
