#include "gpu/vulkan_api.hpp"

#include <dlfcn.h>
#include <fmt/format.h>
#include <link.h>

#include <cstddef>
#include <string_view>
#include <vector>

#include "facet/error.hpp"

namespace facet::gpu {

namespace {

template <typename Function>
void require(Function function, const char* name) {
  if (function == nullptr) {
    throw Error(
        ErrorKind::NoDevice,
        fmt::format("the Vulkan loader or driver has no {}: it is older than Vulkan 1.2; install a current "
                    "driver (Debian: apt install libvulkan1 mesa-vulkan-drivers)",
                    name));
  }
}

int collect_library(dl_phdr_info* info, std::size_t /*size*/, void* names) {
  const std::string_view name = info->dlpi_name == nullptr ? "" : info->dlpi_name;
  if (name.find("libvulkan_") != std::string_view::npos ||
      name.find("libVkLayer_") != std::string_view::npos) {
    static_cast<std::vector<std::string>*>(names)->emplace_back(name);
  }
  return 0;
}

}  // namespace

void keep_drivers_open() {
  std::vector<std::string> names;
  dl_iterate_phdr(&collect_library, &names);
  for (const std::string& name : names) {
    dlopen(name.c_str(), RTLD_NOW | RTLD_NOLOAD | RTLD_NODELETE);
  }
}

GlobalApi load_global(const std::string& library) {
  void* handle = dlopen(library.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (handle == nullptr) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("no Vulkan loader: {} cannot be opened; install it with: apt install libvulkan1 "
                            "mesa-vulkan-drivers",
                            library));
  }
  GlobalApi api;
  api.vkGetInstanceProcAddr =
      reinterpret_cast<PFN_vkGetInstanceProcAddr>(dlsym(handle, "vkGetInstanceProcAddr"));
  require(api.vkGetInstanceProcAddr, "vkGetInstanceProcAddr");
#define FACET_VULKAN_LOAD(name)                                                              \
  api.name = reinterpret_cast<PFN_##name>(api.vkGetInstanceProcAddr(VK_NULL_HANDLE, #name)); \
  require(api.name, #name);
  FACET_VULKAN_GLOBAL_FUNCTIONS(FACET_VULKAN_LOAD)
#undef FACET_VULKAN_LOAD
  return api;
}

InstanceApi load_instance(const GlobalApi& global, VkInstance instance, bool with_debug) {
  InstanceApi api;
#define FACET_VULKAN_LOAD(name)                                                           \
  api.name = reinterpret_cast<PFN_##name>(global.vkGetInstanceProcAddr(instance, #name)); \
  require(api.name, #name);
  FACET_VULKAN_INSTANCE_FUNCTIONS(FACET_VULKAN_LOAD)
  if (with_debug) {
    FACET_VULKAN_DEBUG_FUNCTIONS(FACET_VULKAN_LOAD)
  }
#undef FACET_VULKAN_LOAD
  return api;
}

DeviceApi load_device(const InstanceApi& instance, VkDevice device) {
  DeviceApi api;
#define FACET_VULKAN_LOAD(name)                                                         \
  api.name = reinterpret_cast<PFN_##name>(instance.vkGetDeviceProcAddr(device, #name)); \
  require(api.name, #name);
  FACET_VULKAN_DEVICE_FUNCTIONS(FACET_VULKAN_LOAD)
#undef FACET_VULKAN_LOAD
  return api;
}

const char* result_name(VkResult result) {
  switch (result) {
    case VK_SUCCESS:
      return "VK_SUCCESS";
    case VK_NOT_READY:
      return "VK_NOT_READY";
    case VK_TIMEOUT:
      return "VK_TIMEOUT";
    case VK_INCOMPLETE:
      return "VK_INCOMPLETE";
    case VK_ERROR_OUT_OF_HOST_MEMORY:
      return "VK_ERROR_OUT_OF_HOST_MEMORY";
    case VK_ERROR_OUT_OF_DEVICE_MEMORY:
      return "VK_ERROR_OUT_OF_DEVICE_MEMORY";
    case VK_ERROR_INITIALIZATION_FAILED:
      return "VK_ERROR_INITIALIZATION_FAILED";
    case VK_ERROR_DEVICE_LOST:
      return "VK_ERROR_DEVICE_LOST";
    case VK_ERROR_MEMORY_MAP_FAILED:
      return "VK_ERROR_MEMORY_MAP_FAILED";
    case VK_ERROR_LAYER_NOT_PRESENT:
      return "VK_ERROR_LAYER_NOT_PRESENT";
    case VK_ERROR_EXTENSION_NOT_PRESENT:
      return "VK_ERROR_EXTENSION_NOT_PRESENT";
    case VK_ERROR_FEATURE_NOT_PRESENT:
      return "VK_ERROR_FEATURE_NOT_PRESENT";
    case VK_ERROR_INCOMPATIBLE_DRIVER:
      return "VK_ERROR_INCOMPATIBLE_DRIVER";
    case VK_ERROR_TOO_MANY_OBJECTS:
      return "VK_ERROR_TOO_MANY_OBJECTS";
    case VK_ERROR_FORMAT_NOT_SUPPORTED:
      return "VK_ERROR_FORMAT_NOT_SUPPORTED";
    case VK_ERROR_OUT_OF_POOL_MEMORY:
      return "VK_ERROR_OUT_OF_POOL_MEMORY";
    default:
      return "another Vulkan error";
  }
}

}  // namespace facet::gpu
