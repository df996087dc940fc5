#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "shaders/stereo/layout.h"
#include "stereo/volume.hpp"

namespace facet::stereo {

/// What a solve works on: the voxels that have a start value, in the order and with the links of
/// shaders/stereo/layout.h, and the boxes in which the sums of their windows lie.
class Unknowns {
 public:
  /// band_rows  rows of a band; the last one may have fewer. Throws Error(Usage) for a volume whose places
  /// the layout cannot hold.
  Unknowns(const VolumeSize& size, int radius_x, int radius_y, int radius_t, int band_rows);

  /// Neighbours are linked where both have a disparity and these lie within break_px; NaN: none.
  /// start_px    [slots][height][width]
  /// most_cells  of the boxes of one part; a single band may have more
  void find(std::span<const float> start_px, float break_px, std::size_t most_cells);

  std::size_t count() const { return list_.size(); }
  std::span<const shaders::ivec4> list() const { return list_; }
  /// [count] voxel of each, [slots][height][width].
  std::span<const std::uint32_t> voxels() const { return voxels_; }

  std::span<const shaders::stereo::Band> bands() const { return bands_; }
  int part_count() const { return part_count_; }
  /// Of the largest part, voxels: samples, sums along x, sums along x and y.
  std::size_t most_samples() const { return most_samples_; }
  std::size_t most_sums_x() const { return most_sums_x_; }
  std::size_t most_sums_xy() const { return most_sums_xy_; }

 private:
  void list_voxels(std::span<const float> start_px, float break_px);
  void link();
  void place_bands(std::size_t most_cells);

  struct Box {
    int x, past_x, y, past_y, t, past_t;
  };
  /// Indices in the list of linked neighbours, -1: none.
  struct Near {
    std::int32_t before_y, after_y, before_t, after_t;
    bool before_x;
  };

  VolumeSize size_;
  int rx_, ry_, rt_;
  int band_rows_;
  std::vector<shaders::ivec4> list_;
  std::vector<std::uint32_t> voxels_;
  std::vector<Near> near_;
  std::vector<std::int32_t> row_, row_before_;  ///< [slots][width] indices in the list
  std::vector<Box> boxes_;                      ///< [band]
  std::vector<shaders::stereo::Band> bands_;
  int part_count_ = 1;
  std::size_t most_samples_ = 0, most_sums_x_ = 0, most_sums_xy_ = 0;
};

}  // namespace facet::stereo
