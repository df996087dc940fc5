#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "gpu/device_array.hpp"
#include "shaders/stereo/layout.h"
#include "stereo/start_value.hpp"
#include "stereo/volume.hpp"

namespace facet::stereo {

/// Pictures as StartValue::find takes them, on the device.
struct StartPictures {
  const gpu::Buffer& left;
  const gpu::Buffer& right;
  const gpu::Buffer& usable;  ///< [slots] float: 0 where a slot says nothing
};

/// StartValue's semi-global method on a GPU, of several slots in one batch.
class DeviceStart {
 public:
  /// Why these start values cannot be found on the device; empty where they can.
  static std::string why_not(const gpu::Context& context, const VolumeSize& size, int least_px, int most_px,
                             const StartOptions& options);

  /// The pictures must outlive it, and why_not be empty. Throws Error(NoDevice).
  DeviceStart(gpu::Context& context, const VolumeSize& size, int least_px, int most_px,
              const StartOptions& options, const StartPictures& pictures);

  /// To be found by the next submission of the batch.
  void want(std::span<const std::size_t> slots);
  void record(gpu::Batch& batch);
  /// After the batch: of a slot that was wanted, [height][width], NaN where there is none.
  void read(std::size_t slot, std::span<float> start_px) const;

 private:
  gpu::Context& context_;
  VolumeSize size_;
  shaders::stereo::StartPush push_;
  int chunk_;
  std::uint32_t lanes_;
  const gpu::Buffer& usable_;
  gpu::TexelView left_, right_;
  gpu::Kernel lit_kernel_, normalise_, costs_kernel_, paths_, choose_;
  gpu::DeviceArray lit_, normalised_, costs_;
  gpu::Buffer totals_, centres_, found_;
};

}  // namespace facet::stereo
