#pragma once

#include <cstddef>

namespace facet::stereo {

/// Pictures of consecutive slots, stacked. Arrays over a volume are [slots][height_px][width_px].
struct VolumeSize {
  int width_px = 0;
  int height_px = 0;
  int slots = 0;

  std::size_t slot_voxels() const {
    return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  }
  std::size_t voxels() const { return slot_voxels() * static_cast<std::size_t>(slots); }
  std::size_t voxel(int x, int y, int slot) const {
    return (static_cast<std::size_t>(slot) * static_cast<std::size_t>(height_px) +
            static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(width_px) +
           static_cast<std::size_t>(x);
  }
};

}  // namespace facet::stereo
