#pragma once

#include "gpu/batch.hpp"
#include "gpu/image.hpp"
#include "gpu/kernel.hpp"

namespace facet::gpu {

/// Fills the mip chain of an Rgba16f image: each pixel of level n + 1 is the mean of level n over the area
/// that it covers (three weighted rows or columns where the size is odd), so the mean colour is kept and
/// nothing shifts.
class Downsampler {
 public:
  explicit Downsampler(Context& context);

  /// Records the levels first_level (at least 1) to level_count - 1, each from the one above it. Throws
  /// Error(Internal) for an image of another format.
  void record(Batch& batch, const Image& image, std::uint32_t first_level = 1) const;

 private:
  Kernel kernel_;
  Sampler sampler_;
};

}  // namespace facet::gpu
