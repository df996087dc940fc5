#include "gpu/kernel.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <utility>

#include "gpu/resources.hpp"

namespace facet::gpu {

namespace {

const char* type_name(ConstantType type) {
  switch (type) {
    case ConstantType::Bool:
      return "bool";
    case ConstantType::Int:
      return "int";
    case ConstantType::Uint:
      return "uint";
    case ConstantType::Float:
      return "float";
  }
  return "unknown";
}

const Shader& find(ShaderSet set, std::string_view name) {
  const auto found = std::ranges::find(set, name, &Shader::name);
  if (found == set.end()) {
    std::vector<std::string_view> names;
    std::ranges::transform(set, std::back_inserter(names), &Shader::name);
    throw Error(ErrorKind::Internal,
                fmt::format("there is no kernel '{}'; there are: {}", name, fmt::join(names, ", ")));
  }
  return *found;
}

}  // namespace

VkDescriptorType descriptor_type(BindingType type) {
  switch (type) {
    case BindingType::StorageBuffer:
      return VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    case BindingType::UniformBuffer:
      return VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
    case BindingType::TexelBuffer:
      return VK_DESCRIPTOR_TYPE_UNIFORM_TEXEL_BUFFER;
    case BindingType::SampledImage:
      return VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
    case BindingType::StorageImage:
      return VK_DESCRIPTOR_TYPE_STORAGE_IMAGE;
    case BindingType::StorageTexels:
      return VK_DESCRIPTOR_TYPE_STORAGE_TEXEL_BUFFER;
  }
  return VK_DESCRIPTOR_TYPE_MAX_ENUM;
}

Kernel::Impl::Impl(std::shared_ptr<Device> on, ShaderSet set, std::string_view called,
                   std::span<const Constant> constants)
    : device(std::move(on)), name(called) {
  const Shader& shader = find(set, called);
  interface = shader.interface;
  try {
    make(shader, constants);
  } catch (...) {
    destroy();
    throw;
  }
}

void Kernel::Impl::check_limits() const {
  const VkPhysicalDeviceLimits& limits = device->limits();
  const auto count = [&](BindingType type) {
    return static_cast<std::uint32_t>(std::ranges::count(interface.bindings, type, &BindingInfo::type));
  };
  const std::uint32_t sampled = count(BindingType::TexelBuffer) + count(BindingType::SampledImage);
  const bool bindings_fit = count(BindingType::StorageBuffer) <= limits.maxPerStageDescriptorStorageBuffers &&
                            count(BindingType::UniformBuffer) <= limits.maxPerStageDescriptorUniformBuffers &&
                            sampled <= limits.maxPerStageDescriptorSampledImages &&
                            count(BindingType::StorageImage) + count(BindingType::StorageTexels) <=
                                limits.maxPerStageDescriptorStorageImages &&
                            interface.bindings.size() <= limits.maxPerStageResources;
  const bool workgroup_fits = workgroup_size[0] <= limits.maxComputeWorkGroupSize[0] &&
                              workgroup_size[1] <= limits.maxComputeWorkGroupSize[1] &&
                              workgroup_size[2] <= limits.maxComputeWorkGroupSize[2] &&
                              std::uint64_t{workgroup_size[0]} * workgroup_size[1] * workgroup_size[2] <=
                                  limits.maxComputeWorkGroupInvocations;
  if (!bindings_fit || !workgroup_fits || interface.push_constant_bytes > limits.maxPushConstantsSize) {
    throw Error(
        ErrorKind::Internal,
        fmt::format("kernel '{}': {} bindings, {} bytes of push constants or the workgroup of {} are more "
                    "than the device '{}' has",
                    name, interface.bindings.size(), interface.push_constant_bytes,
                    fmt::join(workgroup_size, "x"), device->info().name));
  }
}

void Kernel::Impl::make(const Shader& shader, std::span<const Constant> constants) {
  const std::string what = fmt::format("build kernel '{}'", name);
  device->check_not_lost(what);
  const Specialization specialization = specialize(constants);
  check_limits();
  make_layouts(what);
  make_pipeline(shader.words, specialization, what);
}

/// Sets the workgroup's size, too.
Kernel::Impl::Specialization Kernel::Impl::specialize(std::span<const Constant> constants) {
  Specialization made;
  workgroup_size = interface.workgroup_size;
  for (const Constant& constant : constants) {
    const auto info = std::ranges::find(interface.constants, constant.name, &ConstantInfo::name);
    if (info == interface.constants.end() || info->type != constant.type) {
      std::vector<std::string> known;
      for (const ConstantInfo& each : interface.constants) {
        known.push_back(fmt::format("{} {}", type_name(each.type), each.name));
      }
      throw Error(ErrorKind::Internal,
                  fmt::format("kernel '{}' has no specialization constant '{} {}'; it has: {}", name,
                              type_name(constant.type), constant.name, fmt::join(known, ", ")));
    }
    made.entries.push_back({info->id, static_cast<std::uint32_t>(made.values.size() * sizeof(std::uint32_t)),
                            sizeof(std::uint32_t)});
    made.values.push_back(constant.bits);
    const int index = static_cast<int>(info - interface.constants.begin());
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (interface.workgroup_size_constant[axis] == index) {
        workgroup_size[axis] = constant.bits;
      }
    }
  }
  return made;
}

void Kernel::Impl::make_layouts(const std::string& what) {
  const DeviceApi& api = device->api();
  std::vector<VkDescriptorSetLayoutBinding> bindings;
  bindings.reserve(interface.bindings.size());
  for (const BindingInfo& binding : interface.bindings) {
    bindings.push_back(
        {binding.binding, descriptor_type(binding.type), 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr});
  }
  VkDescriptorSetLayoutCreateInfo set_info{};
  set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
  set_info.bindingCount = static_cast<std::uint32_t>(bindings.size());
  set_info.pBindings = bindings.data();
  device->check(api.vkCreateDescriptorSetLayout(device->handle(), &set_info, nullptr, &set_layout), what);

  const VkPushConstantRange push{VK_SHADER_STAGE_COMPUTE_BIT, 0,
                                 static_cast<std::uint32_t>(interface.push_constant_bytes)};
  VkPipelineLayoutCreateInfo layout_info{};
  layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  layout_info.setLayoutCount = 1;
  layout_info.pSetLayouts = &set_layout;
  layout_info.pushConstantRangeCount = push.size > 0 ? 1 : 0;
  layout_info.pPushConstantRanges = &push;
  device->check(api.vkCreatePipelineLayout(device->handle(), &layout_info, nullptr, &pipeline_layout), what);
}

void Kernel::Impl::make_pipeline(std::span<const std::uint32_t> words, const Specialization& specialization,
                                 const std::string& what) {
  const DeviceApi& api = device->api();
  VkShaderModuleCreateInfo module_info{};
  module_info.sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO;
  module_info.codeSize = words.size_bytes();
  module_info.pCode = words.data();
  VkShaderModule module = VK_NULL_HANDLE;
  device->check(api.vkCreateShaderModule(device->handle(), &module_info, nullptr, &module), what);

  const VkSpecializationInfo constants{
      static_cast<std::uint32_t>(specialization.entries.size()), specialization.entries.data(),
      specialization.values.size() * sizeof(std::uint32_t), specialization.values.data()};
  VkComputePipelineCreateInfo pipeline_info{};
  pipeline_info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  pipeline_info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  pipeline_info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
  pipeline_info.stage.module = module;
  pipeline_info.stage.pName = "main";
  pipeline_info.stage.pSpecializationInfo = &constants;
  pipeline_info.layout = pipeline_layout;
  const VkResult result = api.vkCreateComputePipelines(device->handle(), device->kernel_cache().handle(), 1,
                                                       &pipeline_info, nullptr, &pipeline);
  api.vkDestroyShaderModule(device->handle(), module, nullptr);
  device->check(result, what);
  device->set_name(VK_OBJECT_TYPE_PIPELINE, handle_bits(pipeline), name);
}

void Kernel::Impl::destroy() {
  if (device->abandoned()) {
    return;
  }
  const DeviceApi& api = device->api();
  api.vkDestroyPipeline(device->handle(), pipeline, nullptr);
  api.vkDestroyPipelineLayout(device->handle(), pipeline_layout, nullptr);
  api.vkDestroyDescriptorSetLayout(device->handle(), set_layout, nullptr);
}

Kernel::Impl::~Impl() {
  destroy();
}

Kernel::Kernel(Context& context, ShaderSet set, std::string_view name,
               std::initializer_list<Constant> constants)
    : Kernel(context, set, name, std::span<const Constant>(constants.begin(), constants.size())) {}
Kernel::Kernel(Context& context, ShaderSet set, std::string_view name, std::span<const Constant> constants)
    : impl_(std::make_unique<Impl>(context.device(), set, name, constants)) {}
Kernel::~Kernel() = default;
Kernel::Kernel(Kernel&&) noexcept = default;
Kernel& Kernel::operator=(Kernel&&) noexcept = default;

const std::string& Kernel::name() const {
  return impl_->name;
}

std::array<std::uint32_t, 3> Kernel::workgroup_size() const {
  return impl_->workgroup_size;
}

const ShaderInterface& Kernel::interface() const {
  return impl_->interface;
}

}  // namespace facet::gpu
