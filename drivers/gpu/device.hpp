#pragma once

// Private to this room: the opened Vulkan device behind a Context.

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "facet/mutex.hpp"
#include "gpu/context.hpp"
#include "gpu/kernel_cache.hpp"
#include "gpu/vulkan_api.hpp"

namespace facet::gpu {

/// A Vulkan instance, with the validation layer where asked for.
class Instance {
 public:
  explicit Instance(const ContextOptions& options);
  ~Instance();
  Instance(const Instance&) = delete;
  Instance& operator=(const Instance&) = delete;

  const InstanceApi& api() const { return api_; }
  bool validation_active() const { return validation_active_; }
  std::vector<std::string> validation_messages() const;

  struct Candidate {
    VkPhysicalDevice handle = VK_NULL_HANDLE;
    DeviceInfo info;
  };
  /// Every physical device, best first.
  std::vector<Candidate> candidates() const;

 private:
  static VKAPI_ATTR VkBool32 VKAPI_CALL collect_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                                        VkDebugUtilsMessageTypeFlagsEXT types,
                                                        const VkDebugUtilsMessengerCallbackDataEXT* data,
                                                        void* user);

  GlobalApi global_;
  InstanceApi api_;
  VkInstance instance_ = VK_NULL_HANDLE;
  VkDebugUtilsMessengerEXT messenger_ = VK_NULL_HANDLE;
  bool validation_active_ = false;
  mutable Mutex messages_mutex_;
  std::vector<std::string> messages_ FACET_GUARDED_BY(messages_mutex_);
};

/// The device, its one compute queue and what every resource needs from them. Any thread.
class Device {
 public:
  explicit Device(const ContextOptions& options);
  ~Device();
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  const DeviceApi& api() const { return api_; }
  VkDevice handle() const { return device_; }
  const DeviceInfo& info() const { return info_; }
  const VkPhysicalDeviceLimits& limits() const { return limits_; }
  const VkPhysicalDeviceMemoryProperties& memory() const { return memory_; }
  std::vector<VkQueueFamilyProperties> queue_families() const;
  bool has_extension(const char* name) const;
  /// chain: nullptr or a property structure to be filled.
  VkPhysicalDeviceProperties properties(void* chain) const;
  const Instance& instance() const { return *instance_; }
  std::uint32_t queue_family() const { return queue_family_; }
  std::uint32_t timestamp_valid_bits() const { return timestamp_valid_bits_; }

  bool lost() const { return lost_.load(std::memory_order_acquire); }
  void mark_lost() { lost_.store(true, std::memory_order_release); }

  /// Lost because it gave no answer in time.
  bool hung() const { return hung_.load(std::memory_order_acquire); }
  void mark_hung() {
    hung_.store(true, std::memory_order_release);
    mark_lost();
  }
  /// For what is not a frame's work.
  std::chrono::milliseconds long_patience() const { return long_work * info_.patience; }

  /// Waits for a fence; VK_TIMEOUT where it takes longer.
  VkResult wait_for(VkFence fence, std::chrono::nanoseconds timeout) const;

  /// Keeps a device that hangs, and with it whatever it may still use, to the end of the process: Vulkan
  /// allows nothing to be destroyed that work in flight uses.
  static void abandon(const std::shared_ptr<Device>& device);
  bool abandoned() const { return abandoned_.load(std::memory_order_acquire); }

  /// Throws DeviceLostError or Error(NoDevice) unless the result is a success. `what` names the thing that
  /// failed: "create buffer 'jacobian'".
  void check(VkResult result, std::string_view what);
  /// Throws DeviceLostError where the device is lost.
  void check_not_lost(std::string_view what) const;

  /// Hands command buffers to the queue. Per-frame safe; does not throw.
  VkResult submit(VkCommandBuffer commands, VkFence fence);

  /// Records into a command buffer, submits it and waits. For set-up.
  static void run_once(const std::shared_ptr<Device>& device, std::string_view what,
                       const std::function<void(VkCommandBuffer)>& record);

  VkFormatFeatureFlags image_features(VkFormat format) const;
  VkFormatFeatureFlags buffer_features(VkFormat format) const;

  struct Allocation {
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint32_t type = 0;
  };
  /// Memory of a type that has all `required` flags, and `preferred` ones where there is such a type. Where
  /// the host must see it, a type that has no room left stands back behind the next: what can be mapped of a
  /// GPU's memory may be 256 MB.
  Allocation allocate(const VkMemoryRequirements& needs, VkMemoryPropertyFlags required,
                      VkMemoryPropertyFlags preferred, std::string_view what);

  KernelCache& kernel_cache() const { return *kernel_cache_; }

  /// Gives an object a name in the messages of the validation layer.
  void set_name(VkObjectType type, std::uint64_t object, std::string_view name) const;

 private:
  static constexpr int long_work = 10;

  void open(const Instance::Candidate& chosen);
  KernelCacheKey kernel_cache_key() const;

  std::shared_ptr<Instance> instance_;
  VkPhysicalDevice physical_ = VK_NULL_HANDLE;
  VkDevice device_ = VK_NULL_HANDLE;
  Mutex queue_mutex_;
  VkQueue queue_ FACET_GUARDED_BY(queue_mutex_) = VK_NULL_HANDLE;  // externally synchronised
  DeviceApi api_;
  DeviceInfo info_;
  VkPhysicalDeviceLimits limits_{};
  std::unique_ptr<KernelCache> kernel_cache_;
  VkPhysicalDeviceMemoryProperties memory_{};
  std::uint32_t queue_family_ = 0;
  std::uint32_t timestamp_valid_bits_ = 0;
  std::atomic<bool> lost_{false};
  std::atomic<bool> hung_{false};
  std::atomic<bool> abandoned_{false};
};

/// A Vulkan handle as the number that set_name and comparisons use; handles are pointers or numbers by
/// platform.
template <typename Handle>
std::uint64_t handle_bits(Handle handle) {
  if constexpr (std::is_pointer_v<Handle>) {
    return reinterpret_cast<std::uint64_t>(handle);
  } else {
    return static_cast<std::uint64_t>(handle);
  }
}

}  // namespace facet::gpu
