#include "gpu/device.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <iterator>
#include <utility>

#include "facet/mutex.hpp"
#include "gpu/driver_files.hpp"
#include "gpu/software_threads.hpp"

namespace facet::gpu {

namespace {

constexpr const char* validation_layer = "VK_LAYER_KHRONOS_validation";
constexpr std::uint32_t needed_version = VK_API_VERSION_1_2;
constexpr std::size_t max_messages = 100;
constexpr const char* install_driver =
    "install a driver (Debian: apt install mesa-vulkan-drivers gives the software device lavapipe on any "
    "machine; GPUs need their maker's or Mesa's driver); where VK_DRIVER_FILES or VK_ICD_FILENAMES is set, "
    "it "
    "must name a driver's .json file";

// Workgroups for kernels that loop over contiguous blocks (DeviceInfo::workgroup_count). Lavapipe: eight for
// each worker thread was best at 12 K to 200 K vertices. GPUs: of 64 lanes each, enough to keep every core of
// the larger ones busy, and few enough that their partial sums add up in one workgroup.
constexpr std::uint32_t software_workgroups_per_thread = 8;
constexpr std::uint32_t integrated_workgroups = 256;
constexpr std::uint32_t discrete_workgroups = 2048;

// Patches: a GPU's small enough that a workgroup's lanes have two vertices each and hundreds of them fill the
// machine; a CPU's large enough that what they overlap is little, small enough for its second cache.
constexpr std::uint32_t software_patch_lanes = 64;
constexpr std::uint32_t software_patch_vertices = 4096;
constexpr std::uint32_t gpu_patch_lanes = 512;
constexpr std::uint32_t gpu_patch_vertices = 512;
constexpr std::uint32_t gpu_patch_places = 1536;
constexpr std::uint32_t most_subgroups = 64;  // as in shaders/common/workgroup_sum.glsl
constexpr std::uint32_t bytes_a_patch_place = 12;
constexpr std::uint32_t kept_shared_bytes = 2048;  // of which sums take half

// A GPU is done with the largest frame in a twentieth of that.
constexpr std::chrono::milliseconds gpu_patience{2'000};
constexpr std::chrono::milliseconds software_patience{60'000};

// Texel views hold a picture's pixels and a level's stencils: 3.7 million of them at 2,560x1,440 px. Desktop
// drivers have a hundred million, some of phones' 65,536.
constexpr std::uint32_t needed_texel_buffer_elements = 1U << 22U;

constexpr const char* portability_subset = "VK_KHR_portability_subset";

bool validation_wanted(Validation validation) {
  if (validation != Validation::FromEnvironment) {
    return validation != Validation::Off;
  }
  const char* set = std::getenv("FACET_VULKAN_VALIDATION");
  return set != nullptr && *set != '\0' && std::strcmp(set, "0") != 0;
}

bool layer_installed(const GlobalApi& global) {
  std::uint32_t count = 0;
  global.vkEnumerateInstanceLayerProperties(&count, nullptr);
  std::vector<VkLayerProperties> layers(count);
  global.vkEnumerateInstanceLayerProperties(&count, layers.data());
  return std::ranges::any_of(layers, [](const VkLayerProperties& layer) {
    return std::strcmp(layer.layerName, validation_layer) == 0;
  });
}

bool instance_extension(const GlobalApi& global, const char* name) {
  std::uint32_t count = 0;
  global.vkEnumerateInstanceExtensionProperties(nullptr, &count, nullptr);
  std::vector<VkExtensionProperties> extensions(count);
  global.vkEnumerateInstanceExtensionProperties(nullptr, &count, extensions.data());
  return std::ranges::any_of(extensions, [name](const VkExtensionProperties& extension) {
    return std::strcmp(extension.extensionName, name) == 0;
  });
}

DeviceType device_type(VkPhysicalDeviceType type) {
  switch (type) {
    case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
      return DeviceType::Discrete;
    case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
      return DeviceType::Integrated;
    case VK_PHYSICAL_DEVICE_TYPE_CPU:
      return DeviceType::Software;
    default:
      return DeviceType::Virtual;
  }
}

std::string lower(std::string_view text) {
  std::string out(text);
  std::ranges::transform(out, out.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return out;
}

bool has_extension(const InstanceApi& api, VkPhysicalDevice device, const char* name) {
  std::uint32_t count = 0;
  api.vkEnumerateDeviceExtensionProperties(device, nullptr, &count, nullptr);
  std::vector<VkExtensionProperties> extensions(count);
  api.vkEnumerateDeviceExtensionProperties(device, nullptr, &count, extensions.data());
  return std::ranges::any_of(extensions, [name](const VkExtensionProperties& extension) {
    return std::strcmp(extension.extensionName, name) == 0;
  });
}

std::vector<VkQueueFamilyProperties> families_of(const InstanceApi& api, VkPhysicalDevice device) {
  std::uint32_t count = 0;
  api.vkGetPhysicalDeviceQueueFamilyProperties(device, &count, nullptr);
  std::vector<VkQueueFamilyProperties> families(count);
  api.vkGetPhysicalDeviceQueueFamilyProperties(device, &count, families.data());
  return families;
}

std::optional<std::uint32_t> compute_queue_family(const InstanceApi& api, VkPhysicalDevice device,
                                                  std::uint32_t* timestamp_bits) {
  const std::vector<VkQueueFamilyProperties> families = families_of(api, device);
  for (std::uint32_t family = 0; family < families.size(); ++family) {
    if ((families[family].queueFlags & VK_QUEUE_COMPUTE_BIT) != 0) {
      *timestamp_bits = families[family].timestampValidBits;
      return family;
    }
  }
  return std::nullopt;
}

/// The features that Facet asks about or turns on, chained for vkGetPhysicalDeviceFeatures2 and
/// vkCreateDevice.
struct Features {
  VkPhysicalDeviceFeatures2 core{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, nullptr, {}};
  VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomic_float{
      VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT,
      nullptr,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE,
      VK_FALSE};
};

DeviceInfo describe_device(const InstanceApi& api, VkPhysicalDevice device) {
  VkPhysicalDeviceDriverProperties driver{};
  driver.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES;
  VkPhysicalDeviceSubgroupProperties subgroup{};
  subgroup.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES;
  subgroup.pNext = &driver;
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = &subgroup;
  api.vkGetPhysicalDeviceProperties2(device, &properties);
  const VkPhysicalDeviceLimits& limits = properties.properties.limits;

  Features features;
  const bool atomics_known = has_extension(api, device, VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME);
  if (atomics_known) {
    features.core.pNext = &features.atomic_float;
  }
  api.vkGetPhysicalDeviceFeatures2(device, &features.core);

  DeviceInfo info;
  info.name = properties.properties.deviceName;
  info.driver = fmt::format("{} {}", driver.driverName, driver.driverInfo);
  info.type = device_type(properties.properties.deviceType);
  info.is_software = info.type == DeviceType::Software;
  info.subgroup_size = subgroup.subgroupSize;
  switch (info.type) {
    case DeviceType::Software:
      info.workgroup_count =
          software_workgroups_per_thread * static_cast<std::uint32_t>(allowed_core_count());
      break;
    case DeviceType::Integrated:
      info.workgroup_count = integrated_workgroups;
      break;
    case DeviceType::Virtual:
    case DeviceType::Discrete:
      info.workgroup_count = discrete_workgroups;
      break;
  }
  if (info.is_software) {
    info.patch_lanes = software_patch_lanes;
    info.patch_vertices = software_patch_vertices;
  } else {
    info.patch_lanes = std::min({gpu_patch_lanes, most_subgroups * subgroup.subgroupSize,
                                 limits.maxComputeWorkGroupInvocations, limits.maxComputeWorkGroupSize[0]});
    info.patch_vertices = gpu_patch_vertices;
    info.patch_places = std::min(
        gpu_patch_places, (limits.maxComputeSharedMemorySize - kept_shared_bytes) / bytes_a_patch_place);
  }
  info.buffer_alignment_bytes = static_cast<std::size_t>(
      std::max({limits.minStorageBufferOffsetAlignment, limits.minUniformBufferOffsetAlignment,
                limits.minTexelBufferOffsetAlignment, VkDeviceSize{16}}));
  info.max_storage_buffer_bytes = limits.maxStorageBufferRange;
  info.max_texel_buffer_elements = limits.maxTexelBufferElements;
  info.shared_memory_bytes = limits.maxComputeSharedMemorySize;
  info.max_push_constant_bytes = limits.maxPushConstantsSize;
  info.patience = info.is_software ? software_patience : gpu_patience;
  info.uploads_to_device = info.type == DeviceType::Discrete || info.type == DeviceType::Virtual;
  info.vendor_id = properties.properties.vendorID;
  info.has_float_atomics = features.atomic_float.shaderBufferFloat32AtomicAdd != VK_FALSE;

  std::vector<std::string> missing;
  std::uint32_t timestamp_bits = 0;
  if (properties.properties.apiVersion < needed_version) {
    missing.emplace_back("Vulkan 1.2");
  }
  if (!compute_queue_family(api, device, &timestamp_bits)) {
    missing.emplace_back("a compute queue");
  }
  if ((subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) == 0 ||
      (subgroup.supportedOperations & VK_SUBGROUP_FEATURE_ARITHMETIC_BIT) == 0) {
    missing.emplace_back("subgroup arithmetic in compute shaders");
  }
  if (limits.maxTexelBufferElements < needed_texel_buffer_elements) {
    missing.push_back(fmt::format("texel buffers of {} elements (it ends at {})",
                                  needed_texel_buffer_elements, limits.maxTexelBufferElements));
  }
  if (features.core.features.shaderStorageImageExtendedFormats == VK_FALSE) {
    missing.emplace_back("storage images of all formats (shaderStorageImageExtendedFormats)");
  }
  info.usable = missing.empty();
  info.why_unusable = info.usable ? "" : fmt::format("it lacks {}", fmt::join(missing, ", "));
  return info;
}

std::string list_for_people(const std::vector<Instance::Candidate>& candidates) {
  std::vector<std::string> lines;
  lines.reserve(candidates.size());
  for (const Instance::Candidate& candidate : candidates) {
    const DeviceInfo& info = candidate.info;
    lines.push_back(fmt::format("'{}' ({}{})", info.name, describe(info.type),
                                info.usable ? "" : ", unusable: " + info.why_unusable));
  }
  return fmt::format("{}", fmt::join(lines, ", "));
}

/// What to do about a device that is not there.
std::string advice(const std::vector<Instance::Candidate>& there) {
  std::vector<DeviceInfo> infos;
  std::ranges::transform(there, std::back_inserter(infos), &Instance::Candidate::info);
  const std::vector<std::string> missing = what_gpus_lack(infos);
  return missing.empty() ? install_driver : fmt::format("{}", fmt::join(missing, "; "));
}

const Instance::Candidate& choose(const std::vector<Instance::Candidate>& candidates,
                                  const std::string& wanted) {
  if (candidates.empty()) {
    throw Error(ErrorKind::NoDevice, fmt::format("no Vulkan device: {}", advice({})));
  }
  const bool any_name = wanted.empty() || wanted == "auto";
  bool named = false;
  for (const Instance::Candidate& candidate : candidates) {
    if (!any_name && lower(candidate.info.name).find(lower(wanted)) == std::string::npos) {
      continue;
    }
    named = true;
    if (candidate.info.usable) {
      return candidate;
    }
  }
  if (any_name || named) {
    throw Error(ErrorKind::NoDevice, fmt::format("no usable Vulkan device{}; there is: {}; {}",
                                                 any_name ? "" : " called '" + wanted + "'",
                                                 list_for_people(candidates), advice(candidates)));
  }
  throw Error(
      ErrorKind::NoDevice,
      fmt::format("no Vulkan device has '{}' in its name; there is: {}; name a part of one of these, or "
                  "\"auto\"",
                  wanted, list_for_people(candidates)));
}

}  // namespace

Instance::Instance(const ContextOptions& options) {
  choose_software_thread_count();
  global_ = load_global(options.loader_library);
  std::uint32_t version = VK_API_VERSION_1_0;
  global_.vkEnumerateInstanceVersion(&version);
  if (version < needed_version) {
    throw Error(
        ErrorKind::NoDevice,
        fmt::format("the Vulkan loader {} is of version {}.{}; Facet needs 1.2 or later: install a "
                    "current libvulkan1",
                    options.loader_library, VK_API_VERSION_MAJOR(version), VK_API_VERSION_MINOR(version)));
  }
  validation_active_ = validation_wanted(options.validation) && layer_installed(global_);
  if (options.validation == Validation::Required && !validation_active_) {
    throw Error(ErrorKind::NoDevice,
                "the Vulkan validation layer is not installed: apt install vulkan-validationlayers");
  }

  VkDebugUtilsMessengerCreateInfoEXT messenger{};
  messenger.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT;
  messenger.messageSeverity =
      VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
  messenger.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
  messenger.pfnUserCallback = &Instance::collect_message;
  messenger.pUserData = this;

  const VkValidationFeatureEnableEXT synchronisation =
      VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
  VkValidationFeaturesEXT validation_features{};
  validation_features.sType = VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT;
  validation_features.pNext = &messenger;
  validation_features.enabledValidationFeatureCount = 1;
  validation_features.pEnabledValidationFeatures = &synchronisation;

  VkApplicationInfo application{};
  application.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO;
  application.pApplicationName = "Facet";
  application.apiVersion = needed_version;

  std::vector<const char*> extensions;
  VkInstanceCreateInfo create{};
  create.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO;
  create.pApplicationInfo = &application;
  if (instance_extension(global_, VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)) {
    // Drivers that lack something of Vulkan, MoltenVK before all, show themselves to those alone who ask.
    create.flags |= VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR;
    extensions.push_back(VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME);
  }
  if (validation_active_) {
    create.pNext = &validation_features;
    create.enabledLayerCount = 1;
    create.ppEnabledLayerNames = &validation_layer;
    extensions.push_back(VK_EXT_DEBUG_UTILS_EXTENSION_NAME);
  }
  create.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
  create.ppEnabledExtensionNames = extensions.data();
  const VkResult result = global_.vkCreateInstance(&create, nullptr, &instance_);
  if (result != VK_SUCCESS) {
    // VK_ERROR_INCOMPATIBLE_DRIVER is the loader's word for "no driver at all".
    throw Error(ErrorKind::NoDevice,
                fmt::format("no Vulkan device ({}): {}", result_name(result), advice({})));
  }
  keep_drivers_open();
  try {
    api_ = load_instance(global_, instance_, validation_active_);
    if (validation_active_) {
      api_.vkCreateDebugUtilsMessengerEXT(instance_, &messenger, nullptr, &messenger_);
    }
  } catch (...) {
    const auto destroy = reinterpret_cast<PFN_vkDestroyInstance>(
        global_.vkGetInstanceProcAddr(instance_, "vkDestroyInstance"));
    if (destroy != nullptr) {
      destroy(instance_, nullptr);
    }
    throw;
  }
}

Instance::~Instance() {
  if (messenger_ != VK_NULL_HANDLE) {
    api_.vkDestroyDebugUtilsMessengerEXT(instance_, messenger_, nullptr);
  }
  api_.vkDestroyInstance(instance_, nullptr);
}

VkBool32 Instance::collect_message(VkDebugUtilsMessageSeverityFlagBitsEXT /*severity*/,
                                   VkDebugUtilsMessageTypeFlagsEXT /*types*/,
                                   const VkDebugUtilsMessengerCallbackDataEXT* data, void* user) {
  auto* self = static_cast<Instance*>(user);
  const Lock lock(self->messages_mutex_);
  if (self->messages_.size() < max_messages) {
    self->messages_.emplace_back(data->pMessage);
  }
  return VK_FALSE;
}

std::vector<std::string> Instance::validation_messages() const {
  const Lock lock(messages_mutex_);
  return messages_;
}

std::vector<Instance::Candidate> Instance::candidates() const {
  std::uint32_t count = 0;
  api_.vkEnumeratePhysicalDevices(instance_, &count, nullptr);
  std::vector<VkPhysicalDevice> handles(count);
  api_.vkEnumeratePhysicalDevices(instance_, &count, handles.data());
  handles.resize(count);
  std::vector<Candidate> found;
  found.reserve(count);
  for (const VkPhysicalDevice handle : handles) {
    found.push_back({handle, describe_device(api_, handle)});
  }
  std::ranges::stable_sort(found, {}, [](const Candidate& candidate) {
    return std::pair(!candidate.info.usable, static_cast<int>(candidate.info.type));
  });
  return found;
}

namespace {

/// Keeps the first instance that opened a GPU to the end of the process, and with it the GPU's driver in
/// memory. Loaded anew for every device, NVIDIA's takes thread-local storage that never comes back: after
/// some sixty devices no more could be opened.
void keep_driver_loaded(const std::shared_ptr<Instance>& instance) {
  static const auto* const kept = new std::shared_ptr<Instance>(instance);
  (void)kept;
}

}  // namespace

Device::Device(const ContextOptions& options) : instance_(std::make_shared<Instance>(options)) {
  const std::vector<Instance::Candidate> candidates = instance_->candidates();
  open(choose(candidates, options.device));
  if (!info_.is_software) {
    keep_driver_loaded(instance_);
  }
  if (options.patience.count() > 0) {
    info_.patience = options.patience;
  }
  if (options.upload_memory != UploadMemory::Auto) {
    info_.uploads_to_device = options.upload_memory == UploadMemory::Device;
  }
  kernel_cache_ = std::make_unique<KernelCache>(api_, device_, kernel_cache_key(),
                                                kernel_cache_folder(options.kernel_cache));
}

KernelCacheKey Device::kernel_cache_key() const {
  VkPhysicalDeviceIDProperties ids{};
  ids.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES;
  const VkPhysicalDeviceProperties found = properties(&ids);
  KernelCacheKey key;
  std::ranges::copy(ids.driverUUID, key.driver.begin());
  std::ranges::copy(found.pipelineCacheUUID, key.pipeline.begin());
  key.vendor_id = found.vendorID;
  key.device_id = found.deviceID;
  key.driver_version = found.driverVersion;
  return key;
}

void Device::open(const Instance::Candidate& chosen) {
  const InstanceApi& instance = instance_->api();
  physical_ = chosen.handle;
  info_ = chosen.info;
  instance.vkGetPhysicalDeviceMemoryProperties(physical_, &memory_);
  limits_ = properties(nullptr).limits;
  queue_family_ = compute_queue_family(instance, physical_, &timestamp_valid_bits_).value();

  const float priority = 1.0F;
  VkDeviceQueueCreateInfo queue{};
  queue.sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO;
  queue.queueFamilyIndex = queue_family_;
  queue.queueCount = 1;
  queue.pQueuePriorities = &priority;

  Features features;
  features.core.features.shaderStorageImageExtendedFormats = VK_TRUE;
  std::vector<const char*> extensions;
  VkDeviceCreateInfo create{};
  create.sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO;
  create.pNext = &features.core;
  create.queueCreateInfoCount = 1;
  create.pQueueCreateInfos = &queue;
  if (info_.has_float_atomics) {
    features.atomic_float.shaderBufferFloat32AtomicAdd = VK_TRUE;
    features.atomic_float.shaderBufferFloat32Atomics = VK_TRUE;
    features.core.pNext = &features.atomic_float;
    extensions.push_back(VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME);
  }
  if (has_extension(portability_subset)) {
    extensions.push_back(portability_subset);  // a device that has it must be opened with it
  }
  create.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
  create.ppEnabledExtensionNames = extensions.data();
  const VkResult opened = instance.vkCreateDevice(physical_, &create, nullptr, &device_);
  if (opened == VK_ERROR_INITIALIZATION_FAILED) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("the Vulkan device '{}' cannot be opened ({}): another program may hold it, or "
                            "its kernel module is of another version than its driver (a restart mends that)",
                            info_.name, result_name(opened)));
  }
  check(opened, "open it");
  try {
    api_ = load_device(instance, device_);
  } catch (...) {
    const auto destroy =
        reinterpret_cast<PFN_vkDestroyDevice>(instance.vkGetDeviceProcAddr(device_, "vkDestroyDevice"));
    if (destroy != nullptr) {
      destroy(device_, nullptr);
    }
    throw;
  }
  api_.vkGetDeviceQueue(device_, queue_family_, 0, &queue_);
}

Device::~Device() {
  if (device_ != VK_NULL_HANDLE && api_.vkDestroyDevice != nullptr) {
    // Nothing is in flight: every batch has waited for its work, or this device was abandoned and is kept.
    kernel_cache_.reset();
    api_.vkDestroyDevice(device_, nullptr);
  }
}

void Device::check(VkResult result, std::string_view what) {
  if (result == VK_ERROR_DEVICE_LOST) {
    mark_lost();
  }
  check_not_lost(what);
  if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY || result == VK_ERROR_OUT_OF_HOST_MEMORY) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("cannot {}: the device '{}' has not enough memory left ({}); end "
                            "other programs that use it or choose another device",
                            what, info_.name, result_name(result)));
  }
  if (result < 0) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("cannot {} on the device '{}': {}", what, info_.name, result_name(result)));
  }
}

void Device::check_not_lost(std::string_view what) const {
  if (lost()) {
    throw DeviceLostError(fmt::format("cannot {}: the device '{}' {}; open it again", what, info_.name,
                                      hung() ? "hangs" : "was lost"));
  }
}

VkResult Device::submit(VkCommandBuffer commands, VkFence fence) {
  if (lost()) {
    return VK_ERROR_DEVICE_LOST;
  }
  VkSubmitInfo submit{};
  submit.sType = VK_STRUCTURE_TYPE_SUBMIT_INFO;
  submit.commandBufferCount = 1;
  submit.pCommandBuffers = &commands;
  VkResult result = VK_SUCCESS;
  {
    const Lock lock(queue_mutex_);
    result = api_.vkQueueSubmit(queue_, 1, &submit, fence);
  }
  if (result == VK_ERROR_DEVICE_LOST) {
    mark_lost();
  }
  return result;
}

VkResult Device::wait_for(VkFence fence, std::chrono::nanoseconds timeout) const {
  const auto ns = std::max(timeout, std::chrono::nanoseconds::zero()).count();
  return api_.vkWaitForFences(device_, 1, &fence, VK_TRUE, static_cast<std::uint64_t>(ns));
}

void Device::abandon(const std::shared_ptr<Device>& device) {
  static Mutex mutex;
  static auto* const kept = new std::vector<std::shared_ptr<Device>>;
  const Lock lock(mutex);
  if (!device->abandoned_.exchange(true)) {
    kept->push_back(device);
  }
}

void Device::run_once(const std::shared_ptr<Device>& device, std::string_view what,
                      const std::function<void(VkCommandBuffer)>& record) {
  device->check_not_lost(what);
  const DeviceApi& api = device->api_;
  VkCommandPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  pool_info.queueFamilyIndex = device->queue_family_;
  VkCommandPool pool = VK_NULL_HANDLE;
  device->check(api.vkCreateCommandPool(device->device_, &pool_info, nullptr, &pool), what);
  VkFence fence = VK_NULL_HANDLE;
  const VkResult result = [&] {
    VkFenceCreateInfo fence_info{};
    fence_info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
    if (const VkResult made = api.vkCreateFence(device->device_, &fence_info, nullptr, &fence);
        made != VK_SUCCESS) {
      return made;
    }
    VkCommandBufferAllocateInfo allocate_info{};
    allocate_info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
    allocate_info.commandPool = pool;
    allocate_info.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    allocate_info.commandBufferCount = 1;
    VkCommandBuffer commands = VK_NULL_HANDLE;
    if (const VkResult made = api.vkAllocateCommandBuffers(device->device_, &allocate_info, &commands);
        made != VK_SUCCESS) {
      return made;
    }
    VkCommandBufferBeginInfo begin{};
    begin.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    api.vkBeginCommandBuffer(commands, &begin);
    record(commands);
    if (const VkResult ended = api.vkEndCommandBuffer(commands); ended != VK_SUCCESS) {
      return ended;
    }
    if (const VkResult sent = device->submit(commands, fence); sent != VK_SUCCESS) {
      return sent;
    }
    return device->wait_for(fence, device->long_patience());
  }();
  if (result == VK_TIMEOUT) {
    device->mark_hung();
    abandon(device);
  } else {
    api.vkDestroyFence(device->device_, fence, nullptr);
    api.vkDestroyCommandPool(device->device_, pool, nullptr);
  }
  device->check(result, what);
}

VkFormatFeatureFlags Device::image_features(VkFormat format) const {
  VkFormatProperties properties{};
  instance_->api().vkGetPhysicalDeviceFormatProperties(physical_, format, &properties);
  return properties.optimalTilingFeatures;
}

VkFormatFeatureFlags Device::buffer_features(VkFormat format) const {
  VkFormatProperties properties{};
  instance_->api().vkGetPhysicalDeviceFormatProperties(physical_, format, &properties);
  return properties.bufferFeatures;
}

std::vector<VkQueueFamilyProperties> Device::queue_families() const {
  return families_of(instance_->api(), physical_);
}

bool Device::has_extension(const char* name) const {
  return gpu::has_extension(instance_->api(), physical_, name);
}

VkPhysicalDeviceProperties Device::properties(void* chain) const {
  VkPhysicalDeviceProperties2 properties{};
  properties.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2;
  properties.pNext = chain;
  instance_->api().vkGetPhysicalDeviceProperties2(physical_, &properties);
  return properties.properties;
}

Device::Allocation Device::allocate(const VkMemoryRequirements& needs, VkMemoryPropertyFlags required,
                                    VkMemoryPropertyFlags preferred, std::string_view what) {
  const bool elsewhere = (required & VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT) != 0;
  VkResult result = VK_SUCCESS;
  for (const VkMemoryPropertyFlags flags : {required | preferred, required}) {
    for (std::uint32_t type = 0; type < memory_.memoryTypeCount; ++type) {
      const bool allowed = (needs.memoryTypeBits & (1U << type)) != 0;
      if (!allowed || (memory_.memoryTypes[type].propertyFlags & flags) != flags) {
        continue;
      }
      VkMemoryAllocateInfo info{};
      info.sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO;
      info.allocationSize = needs.size;
      info.memoryTypeIndex = type;
      VkDeviceMemory memory = VK_NULL_HANDLE;
      result = api_.vkAllocateMemory(device_, &info, nullptr, &memory);
      if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY && elsewhere) {
        continue;
      }
      check(result, what);
      return {memory, type};
    }
  }
  check(result, what);
  throw Error(ErrorKind::NoDevice,
              fmt::format("cannot {}: the device '{}' has no suitable kind of memory", what, info_.name));
}

void Device::set_name(VkObjectType type, std::uint64_t object, std::string_view name) const {
  if (!instance_->validation_active()) {
    return;
  }
  const std::string text(name);
  VkDebugUtilsObjectNameInfoEXT info{};
  info.sType = VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT;
  info.objectType = type;
  info.objectHandle = object;
  info.pObjectName = text.c_str();
  instance_->api().vkSetDebugUtilsObjectNameEXT(device_, &info);
}

}  // namespace facet::gpu
