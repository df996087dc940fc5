#pragma once

// Private to this room: the Vulkan functions it uses, fetched from the loader at run time.

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan_core.h>

#include <string>

namespace facet::gpu {

#define FACET_VULKAN_GLOBAL_FUNCTIONS(X)    \
  X(vkEnumerateInstanceVersion)             \
  X(vkEnumerateInstanceLayerProperties)     \
  X(vkEnumerateInstanceExtensionProperties) \
  X(vkCreateInstance)

#define FACET_VULKAN_INSTANCE_FUNCTIONS(X)    \
  X(vkDestroyInstance)                        \
  X(vkEnumeratePhysicalDevices)               \
  X(vkEnumerateDeviceExtensionProperties)     \
  X(vkGetPhysicalDeviceProperties2)           \
  X(vkGetPhysicalDeviceFeatures2)             \
  X(vkGetPhysicalDeviceMemoryProperties)      \
  X(vkGetPhysicalDeviceQueueFamilyProperties) \
  X(vkGetPhysicalDeviceFormatProperties)      \
  X(vkCreateDevice)                           \
  X(vkGetDeviceProcAddr)

#define FACET_VULKAN_DEBUG_FUNCTIONS(X) \
  X(vkCreateDebugUtilsMessengerEXT)     \
  X(vkDestroyDebugUtilsMessengerEXT)    \
  X(vkSetDebugUtilsObjectNameEXT)

#define FACET_VULKAN_DEVICE_FUNCTIONS(X) \
  X(vkDestroyDevice)                     \
  X(vkGetDeviceQueue)                    \
  X(vkQueueSubmit)                       \
  X(vkAllocateMemory)                    \
  X(vkFreeMemory)                        \
  X(vkMapMemory)                         \
  X(vkCreateBuffer)                      \
  X(vkDestroyBuffer)                     \
  X(vkGetBufferMemoryRequirements)       \
  X(vkBindBufferMemory)                  \
  X(vkCreateBufferView)                  \
  X(vkDestroyBufferView)                 \
  X(vkCreateImage)                       \
  X(vkDestroyImage)                      \
  X(vkGetImageMemoryRequirements)        \
  X(vkBindImageMemory)                   \
  X(vkCreateImageView)                   \
  X(vkDestroyImageView)                  \
  X(vkCreateSampler)                     \
  X(vkDestroySampler)                    \
  X(vkCreateShaderModule)                \
  X(vkDestroyShaderModule)               \
  X(vkCreatePipelineCache)               \
  X(vkDestroyPipelineCache)              \
  X(vkGetPipelineCacheData)              \
  X(vkCreateDescriptorSetLayout)         \
  X(vkDestroyDescriptorSetLayout)        \
  X(vkCreatePipelineLayout)              \
  X(vkDestroyPipelineLayout)             \
  X(vkCreateComputePipelines)            \
  X(vkDestroyPipeline)                   \
  X(vkCreateDescriptorPool)              \
  X(vkDestroyDescriptorPool)             \
  X(vkResetDescriptorPool)               \
  X(vkAllocateDescriptorSets)            \
  X(vkUpdateDescriptorSets)              \
  X(vkCreateCommandPool)                 \
  X(vkDestroyCommandPool)                \
  X(vkResetCommandPool)                  \
  X(vkAllocateCommandBuffers)            \
  X(vkBeginCommandBuffer)                \
  X(vkEndCommandBuffer)                  \
  X(vkCreateFence)                       \
  X(vkDestroyFence)                      \
  X(vkResetFences)                       \
  X(vkWaitForFences)                     \
  X(vkCreateQueryPool)                   \
  X(vkDestroyQueryPool)                  \
  X(vkGetQueryPoolResults)               \
  X(vkCmdResetQueryPool)                 \
  X(vkCmdWriteTimestamp)                 \
  X(vkCmdPipelineBarrier)                \
  X(vkCmdBindPipeline)                   \
  X(vkCmdBindDescriptorSets)             \
  X(vkCmdPushConstants)                  \
  X(vkCmdDispatch)                       \
  X(vkCmdDispatchIndirect)               \
  X(vkCmdCopyBuffer)                     \
  X(vkCmdCopyBufferToImage)              \
  X(vkCmdCopyImageToBuffer)              \
  X(vkCmdFillBuffer)

#define FACET_VULKAN_MEMBER(name) PFN_##name name = nullptr;

/// Functions of the loader itself. The library stays open for the life of the process: drivers leave
/// thread-local destructors and atexit handlers behind that must still find their code.
struct GlobalApi {
  PFN_vkGetInstanceProcAddr vkGetInstanceProcAddr = nullptr;
  FACET_VULKAN_GLOBAL_FUNCTIONS(FACET_VULKAN_MEMBER)
};
struct InstanceApi {
  FACET_VULKAN_INSTANCE_FUNCTIONS(FACET_VULKAN_MEMBER)
  FACET_VULKAN_DEBUG_FUNCTIONS(FACET_VULKAN_MEMBER)  ///< null without the extension
};
struct DeviceApi {
  FACET_VULKAN_DEVICE_FUNCTIONS(FACET_VULKAN_MEMBER)
};

#undef FACET_VULKAN_MEMBER

/// Opens the loader. Throws Error(NoDevice) with what to install where there is none.
GlobalApi load_global(const std::string& library);
InstanceApi load_instance(const GlobalApi& global, VkInstance instance, bool with_debug);
DeviceApi load_device(const InstanceApi& instance, VkDevice device);

/// Keeps the driver and layer libraries that the loader has opened, which would else be closed with the
/// instance and opened again with the next. Drivers leave thread-local destructors behind, and memory
/// checkers need the code to name what it left.
void keep_drivers_open();

/// "VK_ERROR_DEVICE_LOST" and so on.
const char* result_name(VkResult result);

}  // namespace facet::gpu
