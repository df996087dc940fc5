#pragma once

// Private to this room: what a batch records with.

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "gpu/batch.hpp"
#include "gpu/hazards.hpp"
#include "gpu/resources.hpp"

namespace facet::gpu {

/// One side of a barrier.
struct BarrierSide {
  VkPipelineStageFlags stages = 0;
  VkAccessFlags access = 0;
};
/// All that batches do to resources, as the side that is waited for.
BarrierSide everything();

struct Batch::Impl {
  Impl(std::shared_ptr<Device> on, std::string_view called, std::uint32_t stages_at_most);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  /// A resource that is given for one that a kernel declares.
  struct Use {
    std::string_view kernel;
    const BindingInfo& info;
    const Binding& binding;
  };
  /// What is written of it into a descriptor set, of which the type says what is used, and what is done with
  /// it; a resource that is both read and written counts as written.
  struct Descriptor {
    VkDescriptorBufferInfo buffer{};
    VkDescriptorImageInfo image{};
    VkBufferView texels = VK_NULL_HANDLE;
    Access access;
  };

  void make();
  void destroy();
  void begin();
  void check_recording() const;
  [[noreturn]] void misuse(const std::string& what) const;
  void check_range(std::string_view resource, std::size_t there_are, std::size_t offset,
                   std::size_t size) const;
  void check_device(const std::shared_ptr<Device>& other, std::string_view resource) const;
  void begin_stage(const std::string& called);
  void step(std::string_view called, std::span<const Access> accesses);
  void barrier(const BarrierSide& before, const BarrierSide& after);
  VkDescriptorSet allocate_set(VkDescriptorSetLayout layout);
  void bind(const Kernel::Impl& kernel, std::span<const Binding> bindings, std::span<const std::byte> push,
            std::size_t push_alignment, std::vector<Access>& accesses);
  [[noreturn]] void wrong_type(const Use& use) const;
  Descriptor describe_buffer(const Use& use) const;
  Descriptor describe_texels(const Use& use) const;
  Descriptor describe_image(const Use& use) const;
  Descriptor describe(const Use& use) const;
  Access write_descriptor(const Use& use, VkDescriptorSet set) const;
  void copy_image(const Buffer& buffer, const Image& image, std::uint32_t level, std::size_t offset_bytes,
                  bool to_image);
  void timestamp();
  void wait_for_fence();
  void read_stage_times();

  std::shared_ptr<Device> device;
  std::string name;
  VkCommandPool command_pool = VK_NULL_HANDLE;
  VkCommandBuffer commands = VK_NULL_HANDLE;
  VkFence fence = VK_NULL_HANDLE;
  VkQueryPool queries = VK_NULL_HANDLE;
  std::vector<VkDescriptorPool> descriptor_pools;
  std::size_t pool_in_use = 0;
  HazardTracker hazards;
  std::uint32_t most_stages = 0;
  std::vector<StageTime> stages;
  std::string stage_name;  ///< the last that the user gave
  bool times_dispatches = false;
  std::uint32_t timestamps = 0;
  std::vector<std::uint64_t> ticks;  ///< of read_stage_times
  Counts counts;
  bool finished = false;
  bool in_flight = false;      ///< from submit until wait says how it ended
  bool fence_pending = false;  ///< the device may still be at work, also after a simulated loss
};

}  // namespace facet::gpu
