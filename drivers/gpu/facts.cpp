#include "gpu/facts.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <span>
#include <utility>

#include "gpu/device.hpp"
#include "gpu/resources.hpp"

namespace facet::gpu {

namespace {

constexpr std::array<std::pair<VkFlags, const char*>, 6> memory_words{
    {{VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, "device-local"},
     {VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT, "host-visible"},
     {VK_MEMORY_PROPERTY_HOST_COHERENT_BIT, "host-coherent"},
     {VK_MEMORY_PROPERTY_HOST_CACHED_BIT, "host-cached"},
     {VK_MEMORY_PROPERTY_LAZILY_ALLOCATED_BIT, "lazily-allocated"},
     {VK_MEMORY_PROPERTY_PROTECTED_BIT, "protected"}}};
constexpr std::array<std::pair<VkFlags, const char*>, 4> queue_words{
    {{VK_QUEUE_GRAPHICS_BIT, "graphics"},
     {VK_QUEUE_COMPUTE_BIT, "compute"},
     {VK_QUEUE_TRANSFER_BIT, "transfer"},
     {VK_QUEUE_SPARSE_BINDING_BIT, "sparse-binding"}}};

std::string words_of(VkFlags flags, std::span<const std::pair<VkFlags, const char*>> words) {
  std::vector<const char*> said;
  for (const auto& [flag, word] : words) {
    if ((flags & flag) != 0) {
      said.push_back(word);
    }
  }
  return fmt::format("{}", fmt::join(said, " "));
}

void note_use(Context& context, Memory memory, const char* name,
              std::vector<DeviceFacts::MemoryType>& types) {
  const Buffer buffer(context, 64, memory, name);
  std::string& used_for = types.at(buffer.impl().memory_type).used_for;
  used_for = used_for.empty() ? name : fmt::format("{} {}", used_for, name);
}

}  // namespace

DeviceFacts device_facts(Context& context) {
  const Device& device = *context.device();
  const VkPhysicalDeviceLimits& limits = device.limits();
  DeviceFacts facts;
  const VkPhysicalDeviceMemoryProperties& memory = device.memory();
  for (std::uint32_t heap = 0; heap < memory.memoryHeapCount; ++heap) {
    facts.heap_bytes.push_back(memory.memoryHeaps[heap].size);
  }
  for (std::uint32_t type = 0; type < memory.memoryTypeCount; ++type) {
    const VkMemoryType& one = memory.memoryTypes[type];
    facts.memory_types.push_back({words_of(one.propertyFlags, memory_words), one.heapIndex, {}});
  }
  note_use(context, Memory::Device, "Device", facts.memory_types);
  note_use(context, Memory::Upload, "Upload", facts.memory_types);
  note_use(context, Memory::Readback, "Readback", facts.memory_types);

  const std::vector<VkQueueFamilyProperties> families = device.queue_families();
  for (std::uint32_t family = 0; family < families.size(); ++family) {
    const VkQueueFamilyProperties& one = families[family];
    facts.queue_families.push_back({words_of(one.queueFlags, queue_words), one.queueCount,
                                    one.timestampValidBits, family == device.queue_family()});
  }
  VkPhysicalDeviceSubgroupSizeControlProperties sizes{};
  sizes.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES;
  const VkPhysicalDeviceProperties properties =
      device.properties(device.has_extension(VK_EXT_SUBGROUP_SIZE_CONTROL_EXTENSION_NAME) ? &sizes : nullptr);
  facts.subgroup_size_least = sizes.minSubgroupSize;
  facts.subgroup_size_most = sizes.maxSubgroupSize;
  const std::uint32_t version = properties.apiVersion;
  facts.api_version = fmt::format("{}.{}.{}", VK_API_VERSION_MAJOR(version), VK_API_VERSION_MINOR(version),
                                  VK_API_VERSION_PATCH(version));
  facts.workgroup_invocations = limits.maxComputeWorkGroupInvocations;
  facts.workgroups_x = limits.maxComputeWorkGroupCount[0];
  facts.storage_buffers_per_stage = limits.maxPerStageDescriptorStorageBuffers;
  facts.allocations = limits.maxMemoryAllocationCount;
  facts.image_px = limits.maxImageDimension2D;
  facts.timestamp_ns = static_cast<double>(limits.timestampPeriod);
  return facts;
}

}  // namespace facet::gpu
