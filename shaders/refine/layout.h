// Layouts shared by the kernels of shaders/refine and their host side in daemon/refine.
#ifndef FACET_SHADERS_REFINE_LAYOUT_H
#define FACET_SHADERS_REFINE_LAYOUT_H

#include "common/layout.h"

FACET_LAYOUT_BEGIN(refine)

// linear_image makes blocks of so many pixels squared: whole pixels of the quarter image.
FACET_LAYOUT_CONSTANT int kImageBlockPx = 4;
// A pixel of its last mip covers so many squared, and the image is whole tiles, so that every mip is half the
// one before. A vertex reads a mip of half its distance to its neighbours: 64 px are more than any face's are
// in a picture of 2,048 px.
FACET_LAYOUT_CONSTANT int kImageTilePx = 32;
FACET_LAYOUT_CONSTANT int kImageMips = 6;  // with the image itself

// What changes from frame to frame; the host writes it before each submission.
struct FrameParameters {
  vec4 projection;           // fx, fy, cx, cy in pixels of the linear image
  vec4 image_size;           // width, height of the linear image, 1 / width, 1 / height with its padding
  vec4 depth_from_px;        // depth map position = px * xy + zw
  ivec4 region_px;           // x0, y0, x1, y1 (past the end): the part that the face needs, in whole blocks
  float keep_displacements;  // 1: warm start from the previous frame; 0: from nothing
  float keep_lighting;       // 1: the previous frame's light is a prior
  float learn_albedo;        // 1: this frame may add to the albedo's sums
  int reduction;             // source pixels to one pixel of the linear image, in x and in y
  ivec4 source_px;           // width, height of the source; 1: it shows the face, 0: it says nothing; 0
  mat4 view_from_reference;  // shading frames, mm: this camera's from that in which the mesh stands
};
FACET_LAYOUT_SIZE(FrameParameters, 160)
FACET_LAYOUT_OFFSET(FrameParameters, view_from_reference, 96)
FACET_LAYOUT_OFFSET(FrameParameters, region_px, 48)
FACET_LAYOUT_OFFSET(FrameParameters, keep_displacements, 64)
FACET_LAYOUT_OFFSET(FrameParameters, source_px, 80)

// The light of the frame. Written by lighting_solve.
struct Light {
  vec4 low;              // l0 to l3
  vec4 middle;           // l4 to l7
  float last;            // l8
  float gain;            // 1 / mean square of the channels that the face shows: makes residuals relative
  float weight;          // sum of the vertex weights behind it
  float valid;           // 1 once a frame gave a light
  vec4 metric_diagonal;  // metric of colour residuals: xx, yy, zz, 0
  vec4 metric_mixed;     // xy, xz, yz, 0
  vec4 room;             // x: what the irradiance of the room's lamps is multiplied with (refine::RoomLight)
};
FACET_LAYOUT_SIZE(Light, 96)
FACET_LAYOUT_OFFSET(Light, room, 80)
FACET_LAYOUT_OFFSET(Light, metric_diagonal, 48)
FACET_LAYOUT_OFFSET(Light, last, 32)

// Weights and bounds of the displacement solve [MD19 eq. 6].
struct SolvePush {
  uint vertex_count;
  uint pcg_iterations;
  uint first_patch;        // that this dispatch solves
  int first_record;        // of the set of patches: its place among the storage texels is 1
  uint energy_slot;        // where linearise puts its energy
  float smooth_weight;     // w3
  float hierarchy_weight;  // w4, 0 at the coarsest level
  float coarse_weight;     // w5
  float robust_scale;      // Tukey's bound on relative residuals, 0: plain squares
  float bound_mm;          // displacements are held within +- this
  float fold_slope;        // bend at which a fold begins to be spared by w3, 0: never
};
FACET_LAYOUT_SIZE(SolvePush, 44)

struct LevelPush {
  uint vertex_count;
  float has_prior;  // 1: the coarser level's displacements are this level's prior; 0 at the coarsest refined
                    // level
  float refine;     // 1: shading refines this level
  float fixed_keep_prior;  // 1: vertices that shading does not move stand at their prior; 0: at 0
  float bound_mm;          // displacements begin within +- this
};
FACET_LAYOUT_SIZE(LevelPush, 20)

struct DepthPush {
  uint triangle_count;
  uint size_px;  // the depth map is a square
};
FACET_LAYOUT_SIZE(DepthPush, 8)

struct ObservePush {
  uint vertex_count;
  uint depth_size_px;
};
FACET_LAYOUT_SIZE(ObservePush, 8)

// A further camera's colours against those of the cameras before it. Written by view_gain.
struct ViewGain {
  vec4 merged_sum;  // linear RGB that the cameras before show where both see, weighted; the weights
  vec4 view_sum;    // the same of this camera
  vec4 gain;        // RGB: makes this camera's colours the reference camera's
};
FACET_LAYOUT_SIZE(ViewGain, 48)
FACET_LAYOUT_OFFSET(ViewGain, gain, 32)

struct ViewPush {
  uint vertex_count;
  uint last;         // merge_view: 1 for the last camera
  uint group_count;  // workgroups that view_sums runs with
};
FACET_LAYOUT_SIZE(ViewPush, 12)

struct LightingPush {
  uint vertex_count;
  uint group_count;       // workgroups that lighting_sums runs with
  float temporal_weight;  // w1
  float robust_scale;     // 0: plain squares
  float metric_floor;     // added to the residuals' covariance, in units of its mean variance
};
FACET_LAYOUT_SIZE(LightingPush, 20)

struct AlbedoPush {
  uint vertex_count;
  uint iteration;
  float smooth_weight;  // w2
  float frame_quota;    // frames that a vertex learns from
};
FACET_LAYOUT_SIZE(AlbedoPush, 16)

FACET_LAYOUT_END

#endif
