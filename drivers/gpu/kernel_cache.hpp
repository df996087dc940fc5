#pragma once

// Private to this room: kernels compiled once, kept for the next start.

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "facet/mutex.hpp"
#include "gpu/context.hpp"
#include "gpu/vulkan_api.hpp"

namespace facet::gpu {

/// What the kept kernels must have been compiled by and for.
struct KernelCacheKey {
  std::array<std::uint8_t, VK_UUID_SIZE> driver{};    ///< VkPhysicalDeviceIDProperties::driverUUID
  std::array<std::uint8_t, VK_UUID_SIZE> pipeline{};  ///< VkPhysicalDeviceProperties::pipelineCacheUUID
  std::uint32_t vendor_id = 0;
  std::uint32_t device_id = 0;
  std::uint32_t driver_version = 0;
  std::uint32_t zero = 0;

  bool operator==(const KernelCacheKey&) const = default;
};

/// The driver's pipeline cache of one device, filled from a file of an earlier start. A file is a head (who
/// made it, how long its data are, their checksum) and the driver's data. One that is damaged, cut, too large
/// or another driver's, or that others than this user and root may write, counts as not there: drivers do not
/// look well at what they are given, and run it. Any thread.
class KernelCache {
 public:
  /// folder: empty: what is compiled is kept for this device alone. Does not throw for what a file is.
  KernelCache(const DeviceApi& api, VkDevice device, const KernelCacheKey& key,
              const std::filesystem::path& folder);
  ~KernelCache();
  KernelCache(const KernelCache&) = delete;
  KernelCache& operator=(const KernelCache&) = delete;

  VkPipelineCache handle() const { return cache_; }
  KernelCacheState state() const;
  /// Writes the file anew where more was compiled than it holds. What fails is in state().
  void keep() noexcept;

 private:
  std::vector<std::byte> read() FACET_REQUIRES(mutex_);
  void write() FACET_REQUIRES(mutex_);

  const DeviceApi& api_;
  VkDevice device_;
  KernelCacheKey key_;
  VkPipelineCache cache_ = VK_NULL_HANDLE;
  mutable Mutex mutex_;
  KernelCacheState state_ FACET_GUARDED_BY(mutex_);
  std::size_t kept_bytes_ FACET_GUARDED_BY(mutex_) = 0;  ///< the driver's data in the file
};

}  // namespace facet::gpu
