#pragma once

#include <cstddef>
#include <string_view>

#include "gpu/batch.hpp"

namespace facet::gpu {

/// A buffer and the texel view that kernels read it through.
struct DeviceArray {
  DeviceArray(Context& context, std::size_t count, TexelFormat format, std::string_view name,
              Memory memory = Memory::Device)
      : buffer(context, count * texel_bytes(format), memory, name), view(buffer, format) {}

  Buffer buffer;
  TexelView view;
};

/// Sets buffers to 0 and waits. Set-up only. Throws DeviceLostError.
inline void clear(Context& context, std::initializer_list<const Buffer*> buffers) {
  run_now(context, "clear", [&](Batch& batch) {
    for (const Buffer* buffer : buffers) {
      batch.fill(*buffer);
    }
  });
}

}  // namespace facet::gpu
