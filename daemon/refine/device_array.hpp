#pragma once

#include <cstddef>
#include <string_view>

#include "gpu/batch.hpp"

namespace facet::refine {

/// A buffer and the texel view that kernels read it through.
struct DeviceArray {
  DeviceArray(gpu::Context& context, std::size_t count, gpu::TexelFormat format, std::string_view name,
              gpu::Memory memory = gpu::Memory::Device)
      : buffer(context, count * gpu::texel_bytes(format), memory, name), view(buffer, format) {}

  gpu::Buffer buffer;
  gpu::TexelView view;
};

/// Sets buffers to 0 and waits. Set-up only.
inline void clear(gpu::Context& context, std::initializer_list<const gpu::Buffer*> buffers) {
  gpu::Batch batch(context, "clear");
  batch.stage("clear");
  for (const gpu::Buffer* buffer : buffers) {
    batch.fill(*buffer);
  }
  batch.finish();
  if (batch.submit() != gpu::Outcome::Done || batch.wait() != gpu::Outcome::Done) {
    throw gpu::DeviceLostError("the GPU was lost while its buffers were cleared; open it again");
  }
}

}  // namespace facet::refine
