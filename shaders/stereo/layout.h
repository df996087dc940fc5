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

// One step of a solve, over all unknowns of a volume. Order of every array over voxels: [t][y][x]; over unknowns: ascending y, in a
// row ascending t, in a slot's row ascending x.
struct SolvePush {
  ivec4 volume;         // width, height, slots of the volume, bands
  uint part;            // of the bands: whose windows are summed
  uint step;            // Gauss-Newton
  uint iteration;       // of the CG solve
  uint last;            // 1 in its last iteration
  float damping;        // 1 / px^2, pull of an update to 0
  float most_move_px;   // an update is held within +- this
  float noise;          // standard deviation of a grey value
  float straddle_px;    // spread of the field about a window's plane at which the window stops bending it
  float least_texture;  // standard deviation of a window's grey values below which it says nothing
};
FACET_LAYOUT_SIZE(SolvePush, 64)
FACET_LAYOUT_OFFSET(SolvePush, part, 16)
FACET_LAYOUT_OFFSET(SolvePush, damping, 32)

// Rows of a volume whose windows are summed together, and where their sums lie.
struct Band {
  ivec4 origin;  // of the least box around its unknowns: x, y; the first slot that their windows reach; part
  ivec4 extent;  // of the box: width, height; slots that the windows reach; where its samples begin
  ivec4 places;  // first and past-the-end unknown; where its sums along x and its sums along x and y begin, voxels
};
FACET_LAYOUT_SIZE(Band, 48)

// An unknown: x, y and t (12, 12 and 8 bits), then the word of its links, then how far before and after it in the list its linked
// neighbours are: along y in 19 bits, along t in 13 above them; 0: not linked. Along x it is the next one.
FACET_LAYOUT_CONSTANT uint kMost_px = 4096;
FACET_LAYOUT_CONSTANT uint kMostSlots = 256;
FACET_LAYOUT_CONSTANT uint kAlongYBits = 19;

// Links of an unknown: four bits for each of x, y and t: it is linked to the voxel before, to the one after, the one before to its
// own before, the one after to its own after.
FACET_LAYOUT_CONSTANT uint kLinkBefore = 1;
FACET_LAYOUT_CONSTANT uint kLinkAfter = 2;
FACET_LAYOUT_CONSTANT uint kBeforeHasBefore = 4;
FACET_LAYOUT_CONSTANT uint kAfterHasAfter = 8;

// Disparity of what is no unknown.
FACET_LAYOUT_CONSTANT float kNoDisparity = -1e9f;

// Start values of some slots at once, the chunk.
struct StartPush {
  ivec4 volume;       // width, height, slots; first of the chunk in `centres`
  int least_px;       // disparity
  int used;           // disparities
  int count;          // the same, rounded up to whole words of every lane
  int reach;          // slots of a window to each side
  int step_cost;
  int jump_cost;
  int most_cost;
  float uniqueness;
  float least_grey;
};
FACET_LAYOUT_SIZE(StartPush, 64)
FACET_LAYOUT_OFFSET(StartPush, least_px, 16)
FACET_LAYOUT_OFFSET(StartPush, uniqueness, 44)

FACET_LAYOUT_END

#endif
