#pragma once

// Private to this room: what stands behind buffers, views, images, samplers and kernels.

#include <memory>
#include <string>
#include <vector>

#include "gpu/buffer.hpp"
#include "gpu/device.hpp"
#include "gpu/image.hpp"
#include "gpu/kernel.hpp"

namespace facet::gpu {

struct Buffer::Impl {
  Impl(std::shared_ptr<Device> on, std::size_t bytes, Memory kind, std::string_view called);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::shared_ptr<Device> device;
  std::string name;
  std::size_t size_bytes = 0;
  VkBuffer buffer = VK_NULL_HANDLE;
  VkDeviceMemory memory = VK_NULL_HANDLE;
  std::uint32_t memory_type = 0;
  std::byte* mapped = nullptr;
};

struct TexelView::Impl {
  Impl(const Buffer::Impl& of, TexelFormat format, std::size_t offset, std::size_t element_count);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::shared_ptr<Device> device;
  VkBuffer buffer = VK_NULL_HANDLE;
  VkBufferView view = VK_NULL_HANDLE;
  bool storable = false;  ///< kernels can write through it
  std::size_t offset_bytes = 0;
  std::size_t size_bytes = 0;
};

struct Image::Impl {
  Impl(std::shared_ptr<Device> on, ImageFormat format, std::uint32_t width_px, std::uint32_t height_px,
       std::uint32_t level_count, std::string_view called);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::shared_ptr<Device> device;
  std::string name;
  ImageFormat format = ImageFormat::Rgba8;
  std::uint32_t width_px = 0;
  std::uint32_t height_px = 0;
  bool filters_linearly = false;
  VkImage image = VK_NULL_HANDLE;  ///< always in VK_IMAGE_LAYOUT_GENERAL
  VkDeviceMemory memory = VK_NULL_HANDLE;
  VkImageView all_levels = VK_NULL_HANDLE;
  std::vector<VkImageView> levels;  ///< one view of each level

 private:
  void make(std::uint32_t level_count);
  void destroy();
};

struct Sampler::Impl {
  Impl(std::shared_ptr<Device> on, Filter filter, Filter between_levels);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::shared_ptr<Device> device;
  bool linear = false;
  VkSampler sampler = VK_NULL_HANDLE;
};

struct Kernel::Impl {
  Impl(std::shared_ptr<Device> on, ShaderSet set, std::string_view called,
       std::span<const Constant> constants);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::shared_ptr<Device> device;
  std::string name;
  ShaderInterface interface;
  std::array<std::uint32_t, 3> workgroup_size{1, 1, 1};
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
  VkPipeline pipeline = VK_NULL_HANDLE;

 private:
  struct Specialization {
    std::vector<VkSpecializationMapEntry> entries;
    std::vector<std::uint32_t> values;
  };

  void make(const Shader& shader, std::span<const Constant> constants);
  Specialization specialize(std::span<const Constant> constants);
  void make_layouts(const std::string& what);
  void make_pipeline(std::span<const std::uint32_t> words, const Specialization& specialization,
                     const std::string& what);
  void check_limits() const;
  void destroy();
};

VkDescriptorType descriptor_type(BindingType type);

}  // namespace facet::gpu
