#pragma once

#include <array>

#include "gpu/batch.hpp"
#include "refine/level_buffers.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {

/// The light as kernels read it. gain: 1 / mean square brightness of the face.
shaders::refine::Light pack_light(const std::array<float, 9>& lighting, float gain);
std::array<float, 9> unpack_light(const shaders::refine::Light& light);

struct LightingOptions {
  float temporal_weight = 0;  ///< w1, in units of what all visible vertices weigh together
  float robust_scale = 0;     ///< Tukey's bound on relative residuals in the second pass; 0: one plain pass
  float metric_floor = 1e4F;  ///< see RefinerConfig::metric_floor
};

/// The light of one subject's frames. Nothing known at first.
struct LightingState {
  explicit LightingState(gpu::Context& context);

  gpu::Buffer light;     ///< shaders::refine::Light of the latest frame
  gpu::Buffer previous;  ///< of the frame before
  gpu::Buffer sums;      ///< normal equations of each workgroup
};

/// Estimates the light of the frame on M0 [MD19 eq. 3]: once with plain squares, then again
/// without what that light cannot explain (highlights, shadows, hair).
class LightingKernels {
 public:
  explicit LightingKernels(gpu::Context& context);

  /// Records the estimate. frame: shaders::refine::FrameParameters. The previous frame's result in
  /// lighting.light is the temporal prior and is replaced.
  void record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
              const LightingState& lighting, const gpu::Buffer& frame, const LightingOptions& options) const;

 private:
  void record_pass(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                   const LightingState& lighting, const gpu::Buffer& frame, const LightingOptions& options,
                   float robust_scale) const;

  gpu::Kernel sums_;
  gpu::Kernel solve_;
};

}  // namespace facet::refine
