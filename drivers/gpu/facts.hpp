#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "gpu/buffer.hpp"
#include "gpu/context.hpp"

namespace facet::gpu {

/// What a device says of itself beyond DeviceInfo, for people: `facet doctor`, bench/gpu_facts.
struct DeviceFacts {
  struct MemoryType {
    std::string properties;  ///< "device-local host-visible host-coherent"
    std::uint32_t heap = 0;
    std::string used_for;  ///< "Device", "Upload", "Readback", several of them, or empty
  };
  struct QueueFamily {
    std::string does;  ///< "graphics compute transfer"
    std::uint32_t count = 0;
    std::uint32_t timestamp_bits = 0;
    bool used = false;  ///< by Context
  };
  std::vector<std::uint64_t> heap_bytes;
  std::vector<MemoryType> memory_types;
  std::vector<QueueFamily> queue_families;
  std::string api_version;
  std::uint32_t subgroup_size_least = 0;  ///< 0 where the device has but one size, DeviceInfo::subgroup_size
  std::uint32_t subgroup_size_most = 0;
  std::uint32_t workgroup_invocations = 0;
  std::uint32_t workgroups_x = 0;
  std::uint32_t storage_buffers_per_stage = 0;
  std::uint32_t allocations = 0;
  std::uint32_t image_px = 0;
  double timestamp_ns = 0;  ///< of one tick
};

/// Makes a small buffer of each kind to see where it lies. Throws Error(NoDevice), DeviceLostError.
DeviceFacts device_facts(Context& context);

}  // namespace facet::gpu
