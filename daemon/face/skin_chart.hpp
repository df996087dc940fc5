#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::face {

class ChunkReader;
class ChunkWriter;

/// What is known of one person's skin, on a part of the model's texture chart: a grid of texels, the first of
/// which lies at `least`. Plain data.
struct SkinChart {
  int width = 0;  ///< 0: nothing is known
  int height = 0;
  Eigen::Vector2f least{0, 0};  ///< texture coordinates of the first texel's middle
  float texels_per_unit = 0;
  std::vector<float> relief_mm;  ///< [height][width] of the face at rest over the model's smooth surface,
                                 ///< along its normal
  /// [height][width][3] linear RGB, of the brightness that the model's mean has; 0 where nothing is known.
  /// Empty: none is.
  std::vector<float> albedo;

  bool empty() const { return width == 0; }
  /// What is wrong with it; empty where nothing is.
  std::string check() const;
};

/// A head's relief stays within this, mm; steps of 1 micrometre are kept in files.
inline constexpr float kMostReliefMm = 30;
inline constexpr int kMostChartTexels = 4096;  ///< of a side

/// relief_mm at texture coordinates, linear between texels, 0 beyond the chart. [coordinates] mm.
std::vector<float> relief_at(const SkinChart& chart, const mesh::TextureCoordinates& coordinates);

/// Albedo at texture coordinates, linear between texels; where a texel beside knows none, `elsewhere` with
/// the hue and brightness that what is known has against it. Nothing where the chart has no albedo.
///
/// elsewhere  [3][coordinates] linear RGB, the model's mean
/// Returns [3][coordinates].
mesh::Vertices albedo_at(const SkinChart& chart, const mesh::TextureCoordinates& coordinates,
                         const mesh::Vertices& elsewhere);

/// Adds to the chart's relief what a mesh that lies on it has more, linear within its triangles; texels that
/// no triangle covers stay. What would pass kMostReliefMm ends there.
///
/// coordinates  [2][vertices] texture coordinates
/// more_mm      [vertices]
void add_relief(const mesh::Triangles& triangles, const mesh::TextureCoordinates& coordinates,
                const std::vector<float>& more_mm, SkinChart& chart);

/// The chart in chunks 'SKIN', 'RELI' and 'TONE' (docs/face-model-format.md); nothing where there is none.
void add_skin(const SkinChart& chart, ChunkWriter& writer);
/// The chart that the chunks hold, if any. Throws Error(UnreadableInput).
SkinChart read_skin(const ChunkReader& chunks);

}  // namespace facet::face
