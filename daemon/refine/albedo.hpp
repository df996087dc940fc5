#pragma once

#include <cstdint>

#include "gpu/batch.hpp"
#include "refine/level_buffers.hpp"

namespace facet::refine {

struct AlbedoOptions {
  /// w2, of the squared Laplacian of rho - rho_mean against the squared error of rho at a vertex of mean
  /// brightness that was seen in all frames.
  float smooth_weight = 0;
  float frame_quota = 20;   ///< frames that one vertex learns from
  int pcg_iterations = 12;  ///< per frame; the next frame goes on from there
};

/// What one subject's frames have said about its albedo on one level. Nothing at first.
struct AlbedoState {
  AlbedoState(gpu::Context& context, std::uint32_t vertex_count, int pcg_iterations);

  /// How much the latest recorded frame added: the sum of the weights of the vertices that still learn.
  float gained_in_frame(std::uint32_t workgroup_count) const;

  DeviceArray mean;    ///< the face model's mean albedo, [vertex_count] linear RGB and 0; the host writes it
  DeviceArray sums;    ///< over frames, [vertex_count] sum of w (l . SH) I, sum of w (l . SH)^2
  DeviceArray counts;  ///< over frames, [vertex_count] sum of w
  gpu::Buffer gained;  ///< [workgroup], for the host
  DeviceArray deviations;  ///< rho - tint rho_mean as solved last, [vertex_count]
  // Of the solve:
  gpu::Buffer tints;
  gpu::Buffer tint;
  DeviceArray bends;
  gpu::Buffer units;
  gpu::Buffer luminances;
  gpu::Buffer states;
  DeviceArray changes;
  DeviceArray searches;
  DeviceArray scalars;
};

/// Learns the albedo of one level over several frames [MD19 eq. 4]: every vertex adds up what
/// its frames say, so the least-squares problem over all of them is solved at the cost of one. Light and
/// albedo are only known as a product; the mean luminance of what was seen is kept equal to the face model's.
class AlbedoKernels {
 public:
  explicit AlbedoKernels(gpu::Context& context);

  /// Records: add this frame to the sums, solve, and set the level's albedo in state.albedo; light is scaled
  /// to fit. frame: shaders::refine::FrameParameters.
  void record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
              const AlbedoState& albedo, const gpu::Buffer& frame, const gpu::Buffer& light,
              const AlbedoOptions& options) const;

  /// Records the albedo of a coarser level from the next finer one's.
  /// finer_topology, finer  of the finer level
  /// in_finer               [vertex_count] of the coarser level: the vertex in the finer one
  void record_restrict(gpu::Batch& batch, const LevelTopology& finer_topology, const LevelState& finer,
                       const LevelTopology& topology, const LevelState& state,
                       const gpu::TexelView& in_finer) const;

 private:
  gpu::Kernel accumulate_;
  gpu::Kernel bend_;
  gpu::Kernel gradient_;
  gpu::Kernel direction_;
  gpu::Kernel update_;
  gpu::Kernel luminance_;
  gpu::Kernel normalise_;
  gpu::Kernel restrict_;
};

}  // namespace facet::refine
