// Layouts shared by the kernels of shaders/stereo and their host side in daemon/stereo.
#ifndef FACET_SHADERS_STEREO_LAYOUT_H
#define FACET_SHADERS_STEREO_LAYOUT_H

#include "common/layout.h"

FACET_LAYOUT_BEGIN(stereo)

// One picture resampled into one slot of a volume.
struct RectifyPush {
  ivec4 size;  // width, height of the picture, width, height of the volume
  int slot;
  float saturated;  // grey value from which on a pixel says nothing
};
FACET_LAYOUT_SIZE(RectifyPush, 32)
FACET_LAYOUT_OFFSET(RectifyPush, slot, 16)

// One block of the spacetime volume in one Gauss-Newton step. Order of every array: [t][y][x].
struct BlockPush {
  ivec4 volume;         // width, height, slots of the volume
  uint block;           // whose box it is
  uint iteration;       // of the CG solve
  uint last;            // 1 in its last iteration
  uint energy_slot;     // where the energy of this block and step goes
  float damping;        // 1 / px^2, pull of an update to 0
  float most_move_px;   // an update is held within +- this
  float noise;          // standard deviation of a grey value
  float straddle_px;    // spread of the field about a window's plane at which the window stops bending it
  float least_texture;  // standard deviation of a window's grey values below which it says nothing
};
FACET_LAYOUT_SIZE(BlockPush, 64)
FACET_LAYOUT_OFFSET(BlockPush, block, 16)
FACET_LAYOUT_OFFSET(BlockPush, damping, 32)

// Word of a voxel in `links`: bit 0: its disparity is an unknown. Then four bits for each of x, y and t: it
// is linked to the voxel before, to the one after, the one before to its own before, the one after to its own
// after.
FACET_LAYOUT_CONSTANT uint kSolved = 1;
FACET_LAYOUT_CONSTANT uint kLinkBefore = 1;
FACET_LAYOUT_CONSTANT uint kLinkAfter = 2;
FACET_LAYOUT_CONSTANT uint kBeforeHasBefore = 4;
FACET_LAYOUT_CONSTANT uint kAfterHasAfter = 8;

FACET_LAYOUT_END

#endif
