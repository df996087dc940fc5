#include "gpu/buffer.hpp"

#include <fmt/format.h>

#include <cstring>
#include <utility>

#include "gpu/batch.hpp"
#include "gpu/resources.hpp"

namespace facet::gpu {

namespace {

VkFormat vulkan_format(TexelFormat format) {
  switch (format) {
    case TexelFormat::Rgba32f:
      return VK_FORMAT_R32G32B32A32_SFLOAT;
    case TexelFormat::Rg32f:
      return VK_FORMAT_R32G32_SFLOAT;
    case TexelFormat::R32f:
      return VK_FORMAT_R32_SFLOAT;
    case TexelFormat::Rgba16f:
      return VK_FORMAT_R16G16B16A16_SFLOAT;
    case TexelFormat::Rg16f:
      return VK_FORMAT_R16G16_SFLOAT;
    case TexelFormat::R16f:
      return VK_FORMAT_R16_SFLOAT;
    case TexelFormat::R32i:
      return VK_FORMAT_R32_SINT;
    case TexelFormat::R32u:
      return VK_FORMAT_R32_UINT;
    case TexelFormat::Rg32i:
      return VK_FORMAT_R32G32_SINT;
    case TexelFormat::Rgba32i:
      return VK_FORMAT_R32G32B32A32_SINT;
    case TexelFormat::Rgba8:
      return VK_FORMAT_R8G8B8A8_UNORM;
  }
  return VK_FORMAT_UNDEFINED;
}

struct MemoryFlags {
  VkMemoryPropertyFlags required;
  VkMemoryPropertyFlags preferred;
};

MemoryFlags memory_flags(Memory kind, const DeviceInfo& info) {
  constexpr VkMemoryPropertyFlags mapped =
      VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
  switch (kind) {
    case Memory::Upload:
      return {mapped,
              info.uploads_to_device ? VkMemoryPropertyFlags{VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT} : 0U};
    case Memory::Readback:
      return {mapped, VK_MEMORY_PROPERTY_HOST_CACHED_BIT};
    case Memory::Device:
      break;
  }
  return {0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
}

void check_range(const Buffer& buffer, std::size_t offset_bytes, std::size_t size_bytes) {
  if (offset_bytes > buffer.size_bytes() || size_bytes > buffer.size_bytes() - offset_bytes) {
    throw Error(ErrorKind::Internal,
                fmt::format("buffer '{}': {} bytes at {} are outside its {} bytes", buffer.impl().name,
                            size_bytes, offset_bytes, buffer.size_bytes()));
  }
}

}  // namespace

Buffer::Impl::Impl(std::shared_ptr<Device> on, std::size_t bytes, Memory kind, std::string_view called)
    : device(std::move(on)), name(called), size_bytes(bytes) {
  if (bytes == 0 || bytes > device->info().max_storage_buffer_bytes) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("buffer '{}': {} bytes, where '{}' can bind 1 to {}", name, bytes,
                            device->info().name, device->info().max_storage_buffer_bytes));
  }
  const std::string what = fmt::format("create buffer '{}' of {} bytes", name, bytes);
  device->check_not_lost(what);
  const DeviceApi& api = device->api();
  VkBufferCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO;
  info.size = bytes;
  info.usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT |
               VK_BUFFER_USAGE_UNIFORM_TEXEL_BUFFER_BIT | VK_BUFFER_USAGE_STORAGE_TEXEL_BUFFER_BIT |
               VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT | VK_BUFFER_USAGE_STORAGE_BUFFER_BIT |
               VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT;
  device->check(api.vkCreateBuffer(device->handle(), &info, nullptr, &buffer), what);
  try {
    VkMemoryRequirements needs{};
    api.vkGetBufferMemoryRequirements(device->handle(), buffer, &needs);
    const MemoryFlags flags = memory_flags(kind, device->info());
    const Device::Allocation allocated = device->allocate(needs, flags.required, flags.preferred, what);
    memory = allocated.memory;
    memory_type = allocated.type;
    device->check(api.vkBindBufferMemory(device->handle(), buffer, memory, 0), what);
    if (kind != Memory::Device) {
      void* address = nullptr;
      device->check(api.vkMapMemory(device->handle(), memory, 0, VK_WHOLE_SIZE, 0, &address), what);
      mapped = static_cast<std::byte*>(address);
    }
  } catch (...) {
    api.vkDestroyBuffer(device->handle(), buffer, nullptr);
    api.vkFreeMemory(device->handle(), memory, nullptr);
    throw;
  }
  device->set_name(VK_OBJECT_TYPE_BUFFER, handle_bits(buffer), name);
}

Buffer::Impl::~Impl() {
  if (device->abandoned()) {
    return;
  }
  device->api().vkDestroyBuffer(device->handle(), buffer, nullptr);
  device->api().vkFreeMemory(device->handle(), memory, nullptr);
}

Buffer::Buffer(Context& context, std::size_t size_bytes, Memory memory, std::string_view name)
    : impl_(std::make_unique<Impl>(context.device(), size_bytes, memory, name)) {}
Buffer::~Buffer() = default;
Buffer::Buffer(Buffer&&) noexcept = default;
Buffer& Buffer::operator=(Buffer&&) noexcept = default;

std::size_t Buffer::size_bytes() const {
  return impl_->size_bytes;
}

std::span<std::byte> Buffer::mapped() const {
  return {impl_->mapped, impl_->mapped == nullptr ? 0 : impl_->size_bytes};
}

std::size_t texel_bytes(TexelFormat format) {
  switch (format) {
    case TexelFormat::Rgba32f:
    case TexelFormat::Rgba32i:
      return 16;
    case TexelFormat::Rg32f:
    case TexelFormat::Rgba16f:
    case TexelFormat::Rg32i:
      return 8;
    case TexelFormat::R32f:
    case TexelFormat::Rg16f:
    case TexelFormat::R32i:
    case TexelFormat::R32u:
    case TexelFormat::Rgba8:
      return 4;
    case TexelFormat::R16f:
      return 2;
  }
  return 0;
}

TexelView::Impl::Impl(const Buffer::Impl& of, TexelFormat format, std::size_t offset,
                      std::size_t element_count)
    : device(of.device), buffer(of.buffer), offset_bytes(offset) {
  const DeviceInfo& info = device->info();
  const std::size_t texel = texel_bytes(format);
  const std::size_t fitting = offset > of.size_bytes ? 0 : (of.size_bytes - offset) / texel;
  const std::size_t elements = element_count == 0 ? fitting : element_count;
  if (offset % info.buffer_alignment_bytes != 0 || elements == 0 || elements > fitting) {
    throw Error(
        ErrorKind::Internal,
        fmt::format("texel view of buffer '{}' ({} bytes): {} elements of {} bytes at {}; the offset must "
                    "be a multiple of {}",
                    of.name, of.size_bytes, elements, texel, offset, info.buffer_alignment_bytes));
  }
  if (elements > info.max_texel_buffer_elements) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("texel view of buffer '{}': {} elements, where '{}' has at most {}; use a "
                            "smaller picture or mesh, or another gpu.device",
                            of.name, elements, info.name, info.max_texel_buffer_elements));
  }
  size_bytes = elements * texel;
  const std::string what = fmt::format("create a texel view of buffer '{}'", of.name);
  device->check_not_lost(what);
  const VkFormat vulkan = vulkan_format(format);
  const VkFormatFeatureFlags features = device->buffer_features(vulkan);
  storable = (features & VK_FORMAT_FEATURE_STORAGE_TEXEL_BUFFER_BIT) != 0;
  if ((features & VK_FORMAT_FEATURE_UNIFORM_TEXEL_BUFFER_BIT) == 0) {
    throw Error(
        ErrorKind::NoDevice,
        fmt::format("cannot {}: the device '{}' has no texel buffers of that format", what, info.name));
  }
  VkBufferViewCreateInfo create{};
  create.sType = VK_STRUCTURE_TYPE_BUFFER_VIEW_CREATE_INFO;
  create.buffer = buffer;
  create.format = vulkan;
  create.offset = offset;
  create.range = size_bytes;
  device->check(device->api().vkCreateBufferView(device->handle(), &create, nullptr, &view), what);
}

TexelView::Impl::~Impl() {
  if (device->abandoned()) {
    return;
  }
  device->api().vkDestroyBufferView(device->handle(), view, nullptr);
}

TexelView::TexelView(const Buffer& buffer, TexelFormat format, std::size_t offset_bytes,
                     std::size_t element_count)
    : impl_(std::make_unique<Impl>(buffer.impl(), format, offset_bytes, element_count)) {}
TexelView::~TexelView() = default;
TexelView::TexelView(TexelView&&) noexcept = default;
TexelView& TexelView::operator=(TexelView&&) noexcept = default;

void upload(Context& context, const Buffer& target, std::span<const std::byte> bytes,
            std::size_t offset_bytes) {
  check_range(target, offset_bytes, bytes.size());
  if (bytes.empty()) {
    return;
  }
  if (!target.mapped().empty()) {
    std::memcpy(target.mapped().data() + offset_bytes, bytes.data(), bytes.size());
    return;
  }
  const Buffer staging(context, bytes.size(), Memory::Upload, "upload staging");
  std::memcpy(staging.mapped().data(), bytes.data(), bytes.size());
  run_now(context, "upload",
          [&](Batch& batch) { batch.copy(staging, target, bytes.size(), 0, offset_bytes); });
}

void download(Context& context, const Buffer& source, std::span<std::byte> bytes, std::size_t offset_bytes) {
  check_range(source, offset_bytes, bytes.size());
  if (bytes.empty()) {
    return;
  }
  if (!source.mapped().empty()) {
    std::memcpy(bytes.data(), source.mapped().data() + offset_bytes, bytes.size());
    return;
  }
  const Buffer staging(context, bytes.size(), Memory::Readback, "download staging");
  run_now(context, "download",
          [&](Batch& batch) { batch.copy(source, staging, bytes.size(), offset_bytes, 0); });
  std::memcpy(bytes.data(), staging.mapped().data(), bytes.size());
}

}  // namespace facet::gpu
