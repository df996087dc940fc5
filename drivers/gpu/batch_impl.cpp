#include "gpu/batch_impl.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

namespace facet::gpu {

namespace {

// Descriptor sets come from pools of this many, with this many descriptors of each type on average.
constexpr std::uint32_t sets_per_pool = 64;
constexpr std::uint32_t descriptors_per_set = 8;

constexpr std::array descriptor_types{
    VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,       VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER,
    VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER, VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER,
    VK_DESCRIPTOR_TYPE_STORAGE_IMAGE,        VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER};

constexpr std::uint32_t by_anybody = Wait::bit(By::Kernel) | Wait::bit(By::Copy) | Wait::bit(By::Indirect);

/// What has been done by some of By, of which only what they wrote must be made visible.
BarrierSide done_by(std::uint32_t some) {
  BarrierSide side;
  if ((some & Wait::bit(By::Kernel)) != 0) {
    side.stages |= VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT;
    side.access |= VK_ACCESS_SHADER_WRITE_BIT;
  }
  if ((some & Wait::bit(By::Copy)) != 0) {
    side.stages |= VK_PIPELINE_STAGE_TRANSFER_BIT;
    side.access |= VK_ACCESS_TRANSFER_WRITE_BIT;
  }
  if ((some & Wait::bit(By::Indirect)) != 0) {
    side.stages |= VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT;
  }
  return side;
}

/// What some of By are going to do.
BarrierSide to_be_done_by(std::uint32_t some) {
  BarrierSide side = done_by(some);
  if ((some & Wait::bit(By::Kernel)) != 0) {
    side.access |= VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_UNIFORM_READ_BIT;
  }
  if ((some & Wait::bit(By::Copy)) != 0) {
    side.access |= VK_ACCESS_TRANSFER_READ_BIT;
  }
  if ((some & Wait::bit(By::Indirect)) != 0) {
    side.access |= VK_ACCESS_INDIRECT_COMMAND_READ_BIT;
  }
  return side;
}

constexpr double ns_per_ms = 1e6;

std::size_t round_up(std::size_t value, std::size_t multiple) {
  return (value + multiple - 1) / multiple * multiple;
}

const char* type_name(BindingType type) {
  switch (type) {
    case BindingType::StorageBuffer:
      return "a storage buffer";
    case BindingType::UniformBuffer:
      return "a uniform buffer";
    case BindingType::TexelBuffer:
    case BindingType::StorageTexels:
      return "a texel view";
    case BindingType::SampledImage:
      return "an image with a sampler";
    case BindingType::StorageImage:
      return "an image level";
  }
  return "unknown";
}

}  // namespace

BarrierSide everything() {
  return done_by(by_anybody);
}

Batch::Impl::Impl(std::shared_ptr<Device> on, std::string_view called, std::uint32_t stages_at_most)
    : device(std::move(on)), name(called), most_stages(stages_at_most) {
  try {
    make();
    begin();
  } catch (...) {
    destroy();
    throw;
  }
}

void Batch::Impl::make() {
  const std::string what = fmt::format("create batch '{}'", name);
  device->check_not_lost(what);
  const DeviceApi& api = device->api();
  VkCommandPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  pool_info.queueFamilyIndex = device->queue_family();
  device->check(api.vkCreateCommandPool(device->handle(), &pool_info, nullptr, &command_pool), what);
  VkCommandBufferAllocateInfo allocate_info{};
  allocate_info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
  allocate_info.commandPool = command_pool;
  allocate_info.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  allocate_info.commandBufferCount = 1;
  device->check(api.vkAllocateCommandBuffers(device->handle(), &allocate_info, &commands), what);
  VkFenceCreateInfo fence_info{};
  fence_info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
  device->check(api.vkCreateFence(device->handle(), &fence_info, nullptr, &fence), what);
  VkQueryPoolCreateInfo query_info{};
  query_info.sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO;
  query_info.queryType = VK_QUERY_TYPE_TIMESTAMP;
  query_info.queryCount = most_stages + 1;
  device->check(api.vkCreateQueryPool(device->handle(), &query_info, nullptr, &queries), what);
  device->set_name(VK_OBJECT_TYPE_COMMAND_BUFFER, handle_bits(commands), name);
}

void Batch::Impl::destroy() {
  wait_for_fence();
  if (device->abandoned()) {
    return;
  }
  const DeviceApi& api = device->api();
  for (const VkDescriptorPool pool : descriptor_pools) {
    api.vkDestroyDescriptorPool(device->handle(), pool, nullptr);
  }
  api.vkDestroyQueryPool(device->handle(), queries, nullptr);
  api.vkDestroyFence(device->handle(), fence, nullptr);
  api.vkDestroyCommandPool(device->handle(), command_pool, nullptr);
}

Batch::Impl::~Impl() {
  destroy();
}

/// Waits until the device no longer uses the batch. A lost device ends its work in finite time too; one that
/// hangs is abandoned.
void Batch::Impl::wait_for_fence() {
  if (!fence_pending) {
    return;
  }
  const std::chrono::nanoseconds patience =
      device->hung() ? std::chrono::nanoseconds::zero() : device->long_patience();
  if (device->wait_for(fence, patience) == VK_TIMEOUT) {
    device->mark_hung();
    Device::abandon(device);
    return;
  }
  fence_pending = false;
}

void Batch::Impl::begin() {
  const DeviceApi& api = device->api();
  VkCommandBufferBeginInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
  device->check(api.vkBeginCommandBuffer(commands, &info), fmt::format("record batch '{}'", name));
  if (device->timestamp_valid_bits() > 0) {
    api.vkCmdResetQueryPool(commands, queries, 0, most_stages + 1);
  }
  // What earlier submissions wrote must be visible to this one.
  barrier(everything(), to_be_done_by(by_anybody));
  hazards = {};
  counts = {};
}

void Batch::Impl::misuse(const std::string& what) const {
  throw Error(ErrorKind::Internal, fmt::format("batch '{}': {}", name, what));
}

void Batch::Impl::check_recording() const {
  if (finished) {
    misuse("recording after finish; reset it first");
  }
}

void Batch::Impl::check_range(std::string_view resource, std::size_t there_are, std::size_t offset,
                              std::size_t size) const {
  if (size == 0 || offset > there_are || size > there_are - offset) {
    misuse(fmt::format("'{}': {} bytes at {} are outside its {} bytes", resource, size, offset, there_are));
  }
}

void Batch::Impl::check_device(const std::shared_ptr<Device>& other, std::string_view resource) const {
  if (other != device) {
    misuse(fmt::format("'{}' belongs to another context", resource));
  }
}

void Batch::Impl::barrier(const BarrierSide& before, const BarrierSide& after) {
  VkMemoryBarrier memory{};
  memory.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER;
  memory.srcAccessMask = before.access;
  memory.dstAccessMask = after.access;
  device->api().vkCmdPipelineBarrier(commands, before.stages, after.stages, 0, 1, &memory, 0, nullptr, 0,
                                     nullptr);
}

void Batch::Impl::begin_stage(const std::string& called) {
  if (stages.size() == most_stages) {
    misuse(fmt::format("more than {} stages", most_stages));
  }
  timestamp();
  stages.push_back({called, 0.0F});
}

/// Puts a barrier before the step that makes these accesses, where it needs one.
void Batch::Impl::step(std::string_view called, std::span<const Access> accesses) {
  if (times_dispatches) {
    begin_stage(fmt::format("{}/{}", stage_name, called));
  }
  const Wait wait = hazards.wait_for(accesses);
  if (wait.after != 0) {
    barrier(done_by(wait.before), to_be_done_by(wait.after));
    hazards.waited(wait);
    ++counts.barriers;
  }
  hazards.add(accesses);
}

VkDescriptorSet Batch::Impl::allocate_set(VkDescriptorSetLayout layout) {
  const DeviceApi& api = device->api();
  const std::string what = fmt::format("record batch '{}'", name);
  VkDescriptorSetAllocateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  info.descriptorSetCount = 1;
  info.pSetLayouts = &layout;
  VkDescriptorSet set = VK_NULL_HANDLE;
  for (; pool_in_use < descriptor_pools.size(); ++pool_in_use) {
    info.descriptorPool = descriptor_pools[pool_in_use];
    const VkResult result = api.vkAllocateDescriptorSets(device->handle(), &info, &set);
    if (result != VK_ERROR_OUT_OF_POOL_MEMORY && result != VK_ERROR_FRAGMENTED_POOL) {
      device->check(result, what);
      return set;
    }
  }
  std::array<VkDescriptorPoolSize, descriptor_types.size()> sizes{};
  for (std::size_t type = 0; type < sizes.size(); ++type) {
    sizes[type] = {descriptor_types[type], sets_per_pool * descriptors_per_set};
  }
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.maxSets = sets_per_pool;
  pool_info.poolSizeCount = static_cast<std::uint32_t>(sizes.size());
  pool_info.pPoolSizes = sizes.data();
  VkDescriptorPool pool = VK_NULL_HANDLE;
  device->check(api.vkCreateDescriptorPool(device->handle(), &pool_info, nullptr, &pool), what);
  descriptor_pools.push_back(pool);
  info.descriptorPool = pool;
  device->check(api.vkAllocateDescriptorSets(device->handle(), &info, &set), what);
  return set;
}

void Batch::Impl::wrong_type(const Use& use) const {
  misuse(fmt::format("'{}' of kernel '{}' must be {}", use.info.name, use.kernel, type_name(use.info.type)));
}

Batch::Impl::Descriptor Batch::Impl::describe_buffer(const Use& use) const {
  if (use.binding.buffer == nullptr) {
    wrong_type(use);
  }
  const Buffer::Impl& buffer = use.binding.buffer->impl();
  check_device(buffer.device, use.info.name);
  const std::size_t offset = use.binding.offset_bytes;
  const std::size_t size = use.binding.size_bytes != 0
                               ? use.binding.size_bytes
                               : buffer.size_bytes - std::min(offset, buffer.size_bytes);
  check_range(buffer.name, buffer.size_bytes, offset, size);
  if (offset % device->info().buffer_alignment_bytes != 0) {
    misuse(fmt::format("'{}' of kernel '{}' starts at byte {}, which is no multiple of {}", use.info.name,
                       use.kernel, offset, device->info().buffer_alignment_bytes));
  }
  if (use.info.type == BindingType::UniformBuffer && size > device->limits().maxUniformBufferRange) {
    misuse(fmt::format("'{}' of kernel '{}': {} bytes are more than a uniform buffer's {}", use.info.name,
                       use.kernel, size, device->limits().maxUniformBufferRange));
  }
  Descriptor descriptor;
  descriptor.buffer = {buffer.buffer, offset, size};
  descriptor.access = {handle_bits(buffer.buffer), offset, offset + size, use.info.written};
  return descriptor;
}

Batch::Impl::Descriptor Batch::Impl::describe_texels(const Use& use) const {
  if (use.binding.view == nullptr) {
    wrong_type(use);
  }
  const TexelView::Impl& view = use.binding.view->impl();
  check_device(view.device, use.info.name);
  if (use.info.type == BindingType::StorageTexels && !view.storable) {
    misuse(fmt::format("'{}' of kernel '{}': the device '{}' cannot write texels of that format",
                       use.info.name, use.kernel, device->info().name));
  }
  Descriptor descriptor;
  descriptor.texels = view.view;
  descriptor.access = {handle_bits(view.buffer), view.offset_bytes, view.offset_bytes + view.size_bytes,
                       use.info.written};
  return descriptor;
}

Batch::Impl::Descriptor Batch::Impl::describe_image(const Use& use) const {
  const Binding& binding = use.binding;
  const bool sampled = use.info.type == BindingType::SampledImage;
  if (binding.image == nullptr || sampled != (binding.sampler != nullptr)) {
    wrong_type(use);
  }
  const Image::Impl& image = binding.image->impl();
  check_device(image.device, use.info.name);
  if (binding.level >= image.levels.size()) {
    misuse(fmt::format("'{}' of kernel '{}': level {} of image '{}', which has {}", use.info.name, use.kernel,
                       binding.level, image.name, image.levels.size()));
  }
  Descriptor descriptor;
  descriptor.image.imageLayout = VK_IMAGE_LAYOUT_GENERAL;
  descriptor.image.imageView = binding.one_level ? image.levels[binding.level] : image.all_levels;
  if (sampled) {
    const Sampler::Impl& sampler = binding.sampler->impl();
    check_device(sampler.device, use.info.name);
    if (sampler.linear && !image.filters_linearly) {
      misuse(fmt::format("'{}' of kernel '{}': the device '{}' cannot filter image '{}' linearly",
                         use.info.name, use.kernel, device->info().name, image.name));
    }
    descriptor.image.sampler = sampler.sampler;
  }
  descriptor.access = {handle_bits(image.image), binding.one_level ? binding.level : 0,
                       binding.one_level ? std::size_t{binding.level} + 1 : image.levels.size(),
                       use.info.written};
  return descriptor;
}

Batch::Impl::Descriptor Batch::Impl::describe(const Use& use) const {
  switch (use.info.type) {
    case BindingType::StorageBuffer:
    case BindingType::UniformBuffer:
      return describe_buffer(use);
    case BindingType::TexelBuffer:
    case BindingType::StorageTexels:
      return describe_texels(use);
    case BindingType::SampledImage:
    case BindingType::StorageImage:
      return describe_image(use);
  }
  wrong_type(use);
}

/// Returns what the kernel does with the resource.
Access Batch::Impl::write_descriptor(const Use& use, VkDescriptorSet set) const {
  const Descriptor descriptor = describe(use);
  VkWriteDescriptorSet write{};
  write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
  write.dstSet = set;
  write.dstBinding = use.info.binding;
  write.descriptorCount = 1;
  write.descriptorType = descriptor_type(use.info.type);
  // Vulkan reads the one that belongs to the type.
  write.pBufferInfo = &descriptor.buffer;
  write.pImageInfo = &descriptor.image;
  write.pTexelBufferView = &descriptor.texels;
  device->api().vkUpdateDescriptorSets(device->handle(), 1, &write, 0, nullptr);
  return descriptor.access;
}

/// Binds everything a kernel needs and notes what it will read and write.
void Batch::Impl::bind(const Kernel::Impl& kernel, std::span<const Binding> bindings,
                       std::span<const std::byte> push, std::size_t push_alignment,
                       std::vector<Access>& accesses) {
  check_recording();
  check_device(kernel.device, kernel.name);
  const std::size_t push_bytes = kernel.interface.push_constant_bytes;
  if (push.size() != round_up(push_bytes, push_alignment)) {
    misuse(fmt::format("kernel '{}' takes {} bytes of push constants, not {}", kernel.name, push_bytes,
                       push.size()));
  }
  const DeviceApi& api = device->api();
  const std::span<const BindingInfo> wanted = kernel.interface.bindings;
  const std::ptrdiff_t others = std::ssize(accesses);
  const VkDescriptorSet set = allocate_set(kernel.set_layout);
  std::vector<std::uint8_t> given(wanted.size(), 0);
  for (const Binding& binding : bindings) {
    const auto info = std::ranges::find(wanted, binding.name, &BindingInfo::name);
    if (info == wanted.end()) {
      std::vector<std::string_view> names;
      std::ranges::transform(wanted, std::back_inserter(names), &BindingInfo::name);
      misuse(fmt::format("kernel '{}' uses no '{}'; it uses: {}", kernel.name, binding.name,
                         fmt::join(names, ", ")));
    }
    const auto index = static_cast<std::size_t>(info - wanted.begin());
    if (std::exchange(given[index], std::uint8_t{1}) != 0) {
      misuse(fmt::format("'{}' of kernel '{}' is given twice", binding.name, kernel.name));
    }
    const Access access = write_descriptor({kernel.name, *info, binding}, set);
    const auto same = std::find_if(accesses.begin() + others, accesses.end(),
                                   [&](const Access& one) { return conflict(one, access); });
    if (same != accesses.end()) {
      misuse(fmt::format("'{}' and '{}' of kernel '{}' are the same memory, and it is written",
                         bindings[static_cast<std::size_t>(same - accesses.begin() - others)].name,
                         binding.name, kernel.name));
    }
    accesses.push_back(access);
  }
  if (const auto missing = std::ranges::find(given, 0); missing != given.end()) {
    misuse(fmt::format("'{}' of kernel '{}' is not given",
                       wanted[static_cast<std::size_t>(missing - given.begin())].name, kernel.name));
  }
  api.vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, kernel.pipeline);
  if (!wanted.empty()) {
    api.vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, kernel.pipeline_layout, 0, 1, &set,
                                0, nullptr);
  }
  if (push_bytes > 0) {
    api.vkCmdPushConstants(commands, kernel.pipeline_layout, VK_SHADER_STAGE_COMPUTE_BIT, 0,
                           static_cast<std::uint32_t>(push_bytes), push.data());
  }
}

void Batch::Impl::copy_image(const Buffer& buffer, const Image& image, std::uint32_t level,
                             std::size_t offset_bytes, bool to_image) {
  check_recording();
  check_device(buffer.impl().device, buffer.impl().name);
  check_device(image.impl().device, image.impl().name);
  if (level >= image.level_count()) {
    misuse(
        fmt::format("level {} of image '{}', which has {}", level, image.impl().name, image.level_count()));
  }
  const std::size_t size = image.level_bytes(level);
  check_range(buffer.impl().name, buffer.size_bytes(), offset_bytes, size);
  if (offset_bytes % pixel_bytes(image.format()) != 0) {
    misuse(fmt::format("copy of image '{}': byte {} of buffer '{}' is no multiple of a pixel",
                       image.impl().name, offset_bytes, buffer.impl().name));
  }
  const std::array accesses{
      Access{handle_bits(buffer.impl().buffer), offset_bytes, offset_bytes + size, !to_image, By::Copy},
      Access{handle_bits(image.impl().image), level, std::size_t{level} + 1, to_image, By::Copy}};
  step("copy", accesses);
  VkBufferImageCopy region{};
  region.bufferOffset = offset_bytes;
  region.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, level, 0, 1};
  region.imageExtent = {image.width_px(level), image.height_px(level), 1};
  const DeviceApi& api = device->api();
  if (to_image) {
    api.vkCmdCopyBufferToImage(commands, buffer.impl().buffer, image.impl().image, VK_IMAGE_LAYOUT_GENERAL, 1,
                               &region);
  } else {
    api.vkCmdCopyImageToBuffer(commands, image.impl().image, VK_IMAGE_LAYOUT_GENERAL, buffer.impl().buffer, 1,
                               &region);
  }
  ++counts.copies;
}

void Batch::Impl::timestamp() {
  if (device->timestamp_valid_bits() > 0) {
    device->api().vkCmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, queries, timestamps);
    ++timestamps;
  }
}

void Batch::Impl::read_stage_times() {
  if (timestamps == 0) {
    return;
  }
  ticks.resize(timestamps);
  const VkResult result = device->api().vkGetQueryPoolResults(
      device->handle(), queries, 0, timestamps, timestamps * sizeof(std::uint64_t), ticks.data(),
      sizeof(std::uint64_t), VK_QUERY_RESULT_64_BIT);
  if (result != VK_SUCCESS) {
    return;
  }
  const std::uint32_t bits = device->timestamp_valid_bits();
  const std::uint64_t mask = bits >= 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << bits) - 1;
  for (std::size_t stage = 0; stage < stages.size(); ++stage) {
    const std::uint64_t elapsed = (ticks[stage + 1] - ticks[stage]) & mask;
    stages[stage].ms = static_cast<float>(static_cast<double>(elapsed) *
                                          static_cast<double>(device->limits().timestampPeriod) / ns_per_ms);
  }
}

}  // namespace facet::gpu
