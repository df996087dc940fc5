// A Vulkan layer for tests: between the loader and any driver, it is the device that one does not have. The
// file named by FACET_GPU_FAULTS holds its faults, one a line, and is read at every call that it stands
// behind:
//
//   lost-at-submit           every submission reports a lost device
//   lost-at-wait             every wait for work does
//   hang                     submissions are taken and never done
//   cannot-be-opened         another process holds the device
//   memory N                 there is room for N allocations at a time
//   api-version 1.1          what the device says of itself, from here on
//   no-subgroup-arithmetic
//   no-compute-queue
//   no-writes-without-format
//   texel-buffers N          elements
//   discrete                 it is a GPU with a maker's chip
//   three-memories           its memory is of three types: 0 the device's, 1 the host's, 2 the device's,
//   mapped full N                   memory of type N is full

#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <optional>
#include <string>

namespace {

// One driver is opened at a time: what lies below is the same for every instance and device.
std::atomic<VkInstance> instance{VK_NULL_HANDLE};
std::atomic<PFN_vkGetInstanceProcAddr> next_instance_function{nullptr};
std::atomic<PFN_vkGetDeviceProcAddr> next_device_function{nullptr};

/// The number behind a fault, 0 where it has none; nothing where there is no such fault.
std::optional<double> fault(const std::string& wanted) {
  const char* name = std::getenv("FACET_GPU_FAULTS");
  if (name == nullptr) {
    return std::nullopt;
  }
  std::ifstream file(name);
  for (std::string line; std::getline(file, line);) {
    if (line == wanted) {
      return 0;
    }
    if (line.starts_with(wanted + " ")) {
      return std::strtod(line.c_str() + wanted.size() + 1, nullptr);
    }
  }
  return std::nullopt;
}

// Asked for while the instance is made: later the loader would answer with this layer's own.
std::atomic<PFN_vkGetPhysicalDeviceProperties2> next_properties{nullptr};
std::atomic<PFN_vkGetPhysicalDeviceFeatures2> next_features{nullptr};
std::atomic<PFN_vkGetPhysicalDeviceQueueFamilyProperties> next_queue_families{nullptr};
std::atomic<PFN_vkGetPhysicalDeviceMemoryProperties> next_memory{nullptr};

template <typename Function>
void keep(std::atomic<Function>& kept, PFN_vkGetInstanceProcAddr next, VkInstance of, const char* name) {
  kept = reinterpret_cast<Function>(next(of, name));
}

/// The loader's link to the next layer, in the chain behind a create info.
template <typename Link>
Link* find_link(const void* chain, VkStructureType type) {
  for (auto* entry = static_cast<const VkBaseInStructure*>(chain); entry != nullptr; entry = entry->pNext) {
    const auto* link = reinterpret_cast<const Link*>(entry);
    if (entry->sType == type && link->function == VK_LAYER_LINK_INFO) {
      return const_cast<Link*>(link);  // layers advance it: vk_layer.h
    }
  }
  return nullptr;
}

VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info,
                                               const VkAllocationCallbacks* allocator, VkInstance* out) {
  auto* link =
      find_link<VkLayerInstanceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
  if (link == nullptr) {
    return VK_ERROR_INITIALIZATION_FAILED;
  }
  const PFN_vkGetInstanceProcAddr next = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  next_instance_function = next;
  const auto create = reinterpret_cast<PFN_vkCreateInstance>(next(VK_NULL_HANDLE, "vkCreateInstance"));
  const VkResult result = create(info, allocator, out);
  if (result == VK_SUCCESS) {
    instance = *out;
    keep(next_properties, next, *out, "vkGetPhysicalDeviceProperties2");
    keep(next_features, next, *out, "vkGetPhysicalDeviceFeatures2");
    keep(next_queue_families, next, *out, "vkGetPhysicalDeviceQueueFamilyProperties");
    keep(next_memory, next, *out, "vkGetPhysicalDeviceMemoryProperties");
  }
  return result;
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* out) {
  if (fault("cannot-be-opened")) {
    return VK_ERROR_INITIALIZATION_FAILED;
  }
  auto* link = find_link<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
  if (link == nullptr) {
    return VK_ERROR_INITIALIZATION_FAILED;
  }
  const PFN_vkGetInstanceProcAddr next = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
  next_device_function = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
  link->u.pLayerInfo = link->u.pLayerInfo->pNext;
  const auto create = reinterpret_cast<PFN_vkCreateDevice>(next(instance, "vkCreateDevice"));
  return create(physical, info, allocator, out);
}

VKAPI_ATTR void VKAPI_CALL properties(VkPhysicalDevice physical, VkPhysicalDeviceProperties2* out) {
  next_properties.load()(physical, out);
  VkPhysicalDeviceProperties& device = out->properties;
  if (fault("api-version")) {
    device.apiVersion = VK_API_VERSION_1_1;
  }
  if (const auto elements = fault("texel-buffers")) {
    device.limits.maxTexelBufferElements = static_cast<std::uint32_t>(*elements);
  }
  if (fault("discrete")) {
    device.deviceType = VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU;
  }
  for (auto* entry = static_cast<VkBaseOutStructure*>(out->pNext); entry != nullptr; entry = entry->pNext) {
    if (entry->sType == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES &&
        fault("no-subgroup-arithmetic")) {
      auto* subgroup = reinterpret_cast<VkPhysicalDeviceSubgroupProperties*>(entry);
      subgroup->supportedOperations &=
          ~static_cast<VkSubgroupFeatureFlags>(VK_SUBGROUP_FEATURE_ARITHMETIC_BIT);
    }
  }
}

VKAPI_ATTR void VKAPI_CALL features(VkPhysicalDevice physical, VkPhysicalDeviceFeatures2* out) {
  next_features.load()(physical, out);
  if (fault("no-writes-without-format")) {
    out->features.shaderStorageImageWriteWithoutFormat = VK_FALSE;
  }
}

VKAPI_ATTR void VKAPI_CALL queue_families(VkPhysicalDevice physical, std::uint32_t* count,
                                          VkQueueFamilyProperties* out) {
  next_queue_families.load()(physical, count, out);
  if (out != nullptr && fault("no-compute-queue")) {
    for (std::uint32_t family = 0; family < *count; ++family) {
      out[family].queueFlags &= ~static_cast<VkQueueFlags>(VK_QUEUE_COMPUTE_BIT);
    }
  }
}

/// The driver below has one type, which is all three.
VKAPI_ATTR void VKAPI_CALL memory_properties(VkPhysicalDevice physical,
                                             VkPhysicalDeviceMemoryProperties* out) {
  constexpr VkMemoryPropertyFlags mapped =
      VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
  next_memory.load()(physical, out);
  if (fault("three-memories")) {
    out->memoryTypeCount = 3;
    out->memoryTypes[0] = {VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0};
    out->memoryTypes[1] = {mapped | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, 0};
    out->memoryTypes[2] = {mapped | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0};
  }
}

std::atomic<PFN_vkGetBufferMemoryRequirements> next_buffer_needs{nullptr};
std::atomic<PFN_vkGetImageMemoryRequirements> next_image_needs{nullptr};

VKAPI_ATTR void VKAPI_CALL buffer_needs(VkDevice device, VkBuffer buffer, VkMemoryRequirements* out) {
  next_buffer_needs.load()(device, buffer, out);
  out->memoryTypeBits = fault("three-memories") ? 7U : out->memoryTypeBits;
}

VKAPI_ATTR void VKAPI_CALL image_needs(VkDevice device, VkImage image, VkMemoryRequirements* out) {
  next_image_needs.load()(device, image, out);
  out->memoryTypeBits = fault("three-memories") ? 7U : out->memoryTypeBits;
}

std::atomic<PFN_vkQueueSubmit> next_submit{nullptr};
std::atomic<PFN_vkWaitForFences> next_wait{nullptr};
std::atomic<PFN_vkAllocateMemory> next_allocate{nullptr};
std::atomic<PFN_vkFreeMemory> next_free{nullptr};
std::atomic<std::int64_t> allocations{0};

VKAPI_ATTR VkResult VKAPI_CALL submit(VkQueue queue, std::uint32_t count, const VkSubmitInfo* submits,
                                      VkFence fence) {
  if (fault("lost-at-submit")) {
    return VK_ERROR_DEVICE_LOST;
  }
  if (fault("hang")) {
    return VK_SUCCESS;
  }
  return next_submit.load()(queue, count, submits, fence);
}

VKAPI_ATTR VkResult VKAPI_CALL wait(VkDevice device, std::uint32_t count, const VkFence* fences, VkBool32 all,
                                    std::uint64_t timeout_ns) {
  const VkResult result = next_wait.load()(device, count, fences, all, timeout_ns);
  return fault("lost-at-wait") ? VK_ERROR_DEVICE_LOST : result;
}

VKAPI_ATTR VkResult VKAPI_CALL allocate(VkDevice device, const VkMemoryAllocateInfo* info,
                                        const VkAllocationCallbacks* allocator, VkDeviceMemory* out) {
  if (const auto room = fault("memory"); room && static_cast<double>(allocations) >= *room) {
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  }
  if (const auto full = fault("full"); full && static_cast<double>(info->memoryTypeIndex) == *full) {
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
  }
  VkMemoryAllocateInfo below = *info;
  if (fault("three-memories")) {
    below.memoryTypeIndex = 0;
  }
  const VkResult result = next_allocate.load()(device, &below, allocator, out);
  allocations += result == VK_SUCCESS ? 1 : 0;
  return result;
}

VKAPI_ATTR void VKAPI_CALL release(VkDevice device, VkDeviceMemory memory,
                                   const VkAllocationCallbacks* allocator) {
  allocations -= memory == VK_NULL_HANDLE ? 0 : 1;
  next_free.load()(device, memory, allocator);
}

/// Whether the layer has a function of that name; then keeps the driver's.
template <typename Function>
bool stands_before(const char* wanted, const char* name, PFN_vkVoidFunction next,
                   std::atomic<Function>& kept) {
  if (next == nullptr || std::strcmp(name, wanted) != 0) {
    return false;
  }
  kept = reinterpret_cast<Function>(next);
  return true;
}

}  // namespace

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL
fault_layer_device_function(VkDevice device, const char* name) {
  const PFN_vkVoidFunction next = next_device_function.load()(device, name);
  if (stands_before("vkQueueSubmit", name, next, next_submit)) {
    return reinterpret_cast<PFN_vkVoidFunction>(submit);
  }
  if (stands_before("vkWaitForFences", name, next, next_wait)) {
    return reinterpret_cast<PFN_vkVoidFunction>(wait);
  }
  if (stands_before("vkAllocateMemory", name, next, next_allocate)) {
    return reinterpret_cast<PFN_vkVoidFunction>(allocate);
  }
  if (stands_before("vkGetBufferMemoryRequirements", name, next, next_buffer_needs)) {
    return reinterpret_cast<PFN_vkVoidFunction>(buffer_needs);
  }
  if (stands_before("vkGetImageMemoryRequirements", name, next, next_image_needs)) {
    return reinterpret_cast<PFN_vkVoidFunction>(image_needs);
  }
  if (stands_before("vkFreeMemory", name, next, next_free)) {
    return reinterpret_cast<PFN_vkVoidFunction>(release);
  }
  return next;
}

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL
fault_layer_instance_function(VkInstance of, const char* name) {
  const auto is = [name](const char* wanted) { return std::strcmp(name, wanted) == 0; };
  if (is("vkCreateInstance")) {
    return reinterpret_cast<PFN_vkVoidFunction>(create_instance);
  }
  if (is("vkCreateDevice")) {
    return reinterpret_cast<PFN_vkVoidFunction>(create_device);
  }
  if (is("vkGetDeviceProcAddr")) {
    return reinterpret_cast<PFN_vkVoidFunction>(fault_layer_device_function);
  }
  if (is("vkGetPhysicalDeviceProperties2")) {
    return reinterpret_cast<PFN_vkVoidFunction>(properties);
  }
  if (is("vkGetPhysicalDeviceFeatures2")) {
    return reinterpret_cast<PFN_vkVoidFunction>(features);
  }
  if (is("vkGetPhysicalDeviceQueueFamilyProperties")) {
    return reinterpret_cast<PFN_vkVoidFunction>(queue_families);
  }
  if (is("vkGetPhysicalDeviceMemoryProperties")) {
    return reinterpret_cast<PFN_vkVoidFunction>(memory_properties);
  }
  const PFN_vkGetInstanceProcAddr next = next_instance_function;
  return next != nullptr ? next(of, name) : nullptr;
}
