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

/// Sets buffers to 0 and waits. Set-up only. Throws gpu::DeviceLostError.
inline void clear(gpu::Context& context, std::initializer_list<const gpu::Buffer*> buffers) {
  gpu::run_now(context, "clear", [&](gpu::Batch& batch) {
    for (const gpu::Buffer* buffer : buffers) {
      batch.fill(*buffer);
    }
  });
}

}  // namespace facet::refine
