// A Vulkan layer for tests: between the loader and any driver, it reports a lost device for every submission
// while the file named by FACET_LOSE_DEVICE is there.

#include <unistd.h>
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#include <atomic>
#include <cstdlib>
#include <cstring>

namespace {

// One driver is opened at a time: what lies below is the same for every instance and device.
std::atomic<VkInstance> instance{VK_NULL_HANDLE};
std::atomic<PFN_vkGetInstanceProcAddr> next_instance_function{nullptr};
std::atomic<PFN_vkGetDeviceProcAddr> next_device_function{nullptr};

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
  }
  return result;
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* out) {
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

std::atomic<PFN_vkQueueSubmit> next_submit{nullptr};

VKAPI_ATTR VkResult VKAPI_CALL submit(VkQueue queue, std::uint32_t count, const VkSubmitInfo* submits,
                                      VkFence fence) {
  const char* fault = std::getenv("FACET_LOSE_DEVICE");
  if (fault != nullptr && ::access(fault, F_OK) == 0) {
    return VK_ERROR_DEVICE_LOST;
  }
  return next_submit.load()(queue, count, submits, fence);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL
fault_layer_device_function(VkDevice device, const char* name) {
  const PFN_vkVoidFunction next = next_device_function.load()(device, name);
  if (next != nullptr && std::strcmp(name, "vkQueueSubmit") == 0) {
    next_submit = reinterpret_cast<PFN_vkQueueSubmit>(next);
    return reinterpret_cast<PFN_vkVoidFunction>(submit);
  }
  return next;
}

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL
fault_layer_instance_function(VkInstance of, const char* name) {
  if (std::strcmp(name, "vkCreateInstance") == 0) {
    return reinterpret_cast<PFN_vkVoidFunction>(create_instance);
  }
  if (std::strcmp(name, "vkCreateDevice") == 0) {
    return reinterpret_cast<PFN_vkVoidFunction>(create_device);
  }
  if (std::strcmp(name, "vkGetDeviceProcAddr") == 0) {
    return reinterpret_cast<PFN_vkVoidFunction>(fault_layer_device_function);
  }
  const PFN_vkGetInstanceProcAddr next = next_instance_function;
  return next != nullptr ? next(of, name) : nullptr;
}
