#include "gpu/image.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <utility>

#include "gpu/resources.hpp"

namespace facet::gpu {

namespace {

VkFormat vulkan_format(ImageFormat format) {
  switch (format) {
    case ImageFormat::Rgba8:
      return VK_FORMAT_R8G8B8A8_UNORM;
    case ImageFormat::Rgba16f:
      return VK_FORMAT_R16G16B16A16_SFLOAT;
    case ImageFormat::Rgba32f:
      return VK_FORMAT_R32G32B32A32_SFLOAT;
    case ImageFormat::R32f:
      return VK_FORMAT_R32_SFLOAT;
  }
  return VK_FORMAT_UNDEFINED;
}

VkImageView make_view(Device& device, VkImage image, VkFormat format, std::uint32_t first_level,
                      std::uint32_t level_count, std::string_view what) {
  VkImageViewCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO;
  info.image = image;
  info.viewType = VK_IMAGE_VIEW_TYPE_2D;
  info.format = format;
  info.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, first_level, level_count, 0, 1};
  VkImageView view = VK_NULL_HANDLE;
  device.check(device.api().vkCreateImageView(device.handle(), &info, nullptr, &view), what);
  return view;
}

}  // namespace

std::size_t pixel_bytes(ImageFormat format) {
  switch (format) {
    case ImageFormat::Rgba8:
    case ImageFormat::R32f:
      return 4;
    case ImageFormat::Rgba16f:
      return 8;
    case ImageFormat::Rgba32f:
      return 16;
  }
  return 0;
}

Image::Impl::Impl(std::shared_ptr<Device> on, ImageFormat of_format, std::uint32_t width,
                  std::uint32_t height, std::uint32_t level_count, std::string_view called)
    : device(std::move(on)), name(called), format(of_format), width_px(width), height_px(height) {
  const std::uint32_t largest = device->limits().maxImageDimension2D;
  const auto levels_there_are = static_cast<std::uint32_t>(std::bit_width(std::max({width, height, 1U})));
  if (width == 0 || height == 0 || width > largest || height > largest || level_count > levels_there_are) {
    throw Error(
        ErrorKind::NoDevice,
        fmt::format("image '{}': {}x{} pixels with {} levels, where '{}' holds 1x1 to {}x{} and there are {} "
                    "levels",
                    name, width, height, level_count, device->info().name, largest, largest,
                    levels_there_are));
  }
  try {
    make(level_count == 0 ? levels_there_are : level_count);
  } catch (...) {
    destroy();
    throw;
  }
}

void Image::Impl::make(std::uint32_t level_count) {
  const std::string what = fmt::format("create image '{}' of {}x{} pixels", name, width_px, height_px);
  device->check_not_lost(what);
  const DeviceApi& api = device->api();
  const VkFormat vulkan = vulkan_format(format);
  constexpr VkFormatFeatureFlags needed =
      VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT | VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT;
  const VkFormatFeatureFlags features = device->image_features(vulkan);
  if ((features & needed) != needed) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("cannot {}: the device '{}' has no such format", what, device->info().name));
  }
  filters_linearly = (features & VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT) != 0;

  VkImageCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO;
  info.imageType = VK_IMAGE_TYPE_2D;
  info.format = vulkan;
  info.extent = {width_px, height_px, 1};
  info.mipLevels = level_count;
  info.arrayLayers = 1;
  info.samples = VK_SAMPLE_COUNT_1_BIT;
  info.tiling = VK_IMAGE_TILING_OPTIMAL;
  info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT |
               VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_STORAGE_BIT;
  info.initialLayout = VK_IMAGE_LAYOUT_UNDEFINED;
  device->check(api.vkCreateImage(device->handle(), &info, nullptr, &image), what);
  VkMemoryRequirements needs{};
  api.vkGetImageMemoryRequirements(device->handle(), image, &needs);
  memory = device->allocate(needs, 0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, what).memory;
  device->check(api.vkBindImageMemory(device->handle(), image, memory, 0), what);
  device->set_name(VK_OBJECT_TYPE_IMAGE, handle_bits(image), name);

  all_levels = make_view(*device, image, vulkan, 0, level_count, what);
  levels.reserve(level_count);
  for (std::uint32_t level = 0; level < level_count; ++level) {
    levels.push_back(make_view(*device, image, vulkan, level, 1, what));
  }

  Device::run_once(device, what, [&](VkCommandBuffer commands) {
    VkImageMemoryBarrier barrier{};
    barrier.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER;
    barrier.dstAccessMask = VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_SHADER_WRITE_BIT |
                            VK_ACCESS_TRANSFER_READ_BIT | VK_ACCESS_TRANSFER_WRITE_BIT;
    barrier.oldLayout = VK_IMAGE_LAYOUT_UNDEFINED;
    barrier.newLayout = VK_IMAGE_LAYOUT_GENERAL;
    barrier.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.image = image;
    barrier.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, level_count, 0, 1};
    device->api().vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT,
                                       VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT,
                                       0, 0, nullptr, 0, nullptr, 1, &barrier);
  });
}

void Image::Impl::destroy() {
  if (device->abandoned()) {
    return;
  }
  const DeviceApi& api = device->api();
  for (const VkImageView view : levels) {
    api.vkDestroyImageView(device->handle(), view, nullptr);
  }
  api.vkDestroyImageView(device->handle(), all_levels, nullptr);
  api.vkDestroyImage(device->handle(), image, nullptr);
  api.vkFreeMemory(device->handle(), memory, nullptr);
}

Image::Impl::~Impl() {
  destroy();
}

Image::Image(Context& context, ImageFormat format, std::uint32_t width_px, std::uint32_t height_px,
             std::uint32_t level_count, std::string_view name)
    : impl_(std::make_unique<Impl>(context.device(), format, width_px, height_px, level_count, name)) {}
Image::~Image() = default;
Image::Image(Image&&) noexcept = default;
Image& Image::operator=(Image&&) noexcept = default;

ImageFormat Image::format() const {
  return impl_->format;
}

std::uint32_t Image::level_count() const {
  return static_cast<std::uint32_t>(impl_->levels.size());
}

std::uint32_t Image::width_px(std::uint32_t level) const {
  return std::max(1U, impl_->width_px >> level);
}

std::uint32_t Image::height_px(std::uint32_t level) const {
  return std::max(1U, impl_->height_px >> level);
}

std::size_t Image::level_bytes(std::uint32_t level) const {
  return pixel_bytes(impl_->format) * width_px(level) * height_px(level);
}

Sampler::Impl::Impl(std::shared_ptr<Device> on, Filter filter, Filter between_levels)
    : device(std::move(on)), linear(filter == Filter::Linear || between_levels == Filter::Linear) {
  device->check_not_lost("create a sampler");
  VkSamplerCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO;
  info.magFilter = filter == Filter::Linear ? VK_FILTER_LINEAR : VK_FILTER_NEAREST;
  info.minFilter = info.magFilter;
  info.mipmapMode =
      between_levels == Filter::Linear ? VK_SAMPLER_MIPMAP_MODE_LINEAR : VK_SAMPLER_MIPMAP_MODE_NEAREST;
  info.addressModeU = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  info.addressModeV = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  info.addressModeW = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  info.maxLod = VK_LOD_CLAMP_NONE;
  device->check(device->api().vkCreateSampler(device->handle(), &info, nullptr, &sampler),
                "create a sampler");
}

Sampler::Impl::~Impl() {
  if (device->abandoned()) {
    return;
  }
  device->api().vkDestroySampler(device->handle(), sampler, nullptr);
}

Sampler::Sampler(Context& context, Filter filter, Filter between_levels)
    : impl_(std::make_unique<Impl>(context.device(), filter, between_levels)) {}
Sampler::~Sampler() = default;
Sampler::Sampler(Sampler&&) noexcept = default;
Sampler& Sampler::operator=(Sampler&&) noexcept = default;

}  // namespace facet::gpu
