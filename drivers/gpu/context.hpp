#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "facet/error.hpp"

namespace facet::gpu {

class Device;  // private to this room

/// What became of work given to the device. The per-frame functions return it; they never throw.
enum class Outcome {
  Done,
  TimedOut,    ///< not finished within the time given; wait again
  DeviceLost,  ///< nothing that was in flight can be trusted; make a new Context and everything on it
};

/// Thrown by set-up functions (never by the per-frame ones) when the device is lost.
class DeviceLostError : public Error {
 public:
  explicit DeviceLostError(const std::string& message) : Error(ErrorKind::NoDevice, message) {}
};

enum class DeviceType { Discrete, Integrated, Virtual, Software };

/// A Vulkan device and the facts about it that shape the work.
struct DeviceInfo {
  std::string name;
  std::string driver;  ///< driver name and version, for people
  DeviceType type = DeviceType::Software;
  bool is_software = false;
  bool usable = false;              ///< has what Facet needs
  std::string why_unusable;         ///< what is missing, empty where usable
  std::uint32_t vendor_id = 0;      ///< PCI: 0x10de NVIDIA, 0x1002 AMD, 0x8086 Intel
  std::uint32_t subgroup_size = 0;  ///< lanes; 8 on lavapipe, 32 or 64 on GPUs
  /// How many workgroups a kernel that loops over contiguous blocks should start: few on a CPU, where each
  /// costs its start, and enough to fill the machine on a GPU.
  std::uint32_t workgroup_count = 0;
  /// Of a kernel whose workgroups each solve a patch of a mesh: its lanes, a patch's vertices at most, and
  /// how many with those around it fit into shared memory, 12 bytes each; 0 where that is slower than
  /// buffers.
  std::uint32_t patch_lanes = 0;
  std::uint32_t patch_vertices = 0;
  std::uint32_t patch_places = 0;
  std::size_t buffer_alignment_bytes = 0;  ///< every offset of a bound range is a multiple of this
  std::size_t max_storage_buffer_bytes = 0;
  std::size_t max_texel_buffer_elements = 0;
  std::size_t shared_memory_bytes = 0;
  std::size_t max_push_constant_bytes = 0;
  bool has_float_atomics = false;  ///< atomicAdd on float in storage buffers
  /// Memory::Upload lies in the device's own memory where that can be mapped: the host's writes cross the bus
  /// once, and kernels do not wait for it.
  bool uploads_to_device = false;
  /// Work of one frame that is not done by then hangs, and the device counts as lost. Ten times that for
  /// set-up. Short on GPUs; a software device shares its cores with everything else.
  std::chrono::milliseconds patience{0};
};

enum class Validation {
  FromEnvironment,  ///< IfAvailable where FACET_VULKAN_VALIDATION is set and not 0, otherwise Off
  Off,
  IfAvailable,  ///< where the layer is installed; validation_active() tells
  Required,     ///< Error(NoDevice) where the layer is not installed
};

/// Where Memory::Upload lies.
enum class UploadMemory {
  Auto,  ///< DeviceInfo::uploads_to_device as fits the device: true on discrete and virtual GPUs
  Host,
  Device,
};

struct ContextOptions {
  /// "auto": discrete, then integrated, virtual, software. Otherwise part of a device's name, any case.
  std::string device = "auto";
  Validation validation = Validation::FromEnvironment;
  /// Spread lavapipe's worker threads over the cores this process may use, one each: the kernel often puts
  /// two on one core.
  bool pin_software_threads = true;
  std::string loader_library = "libvulkan.so.1";  ///< the Vulkan loader; tests name one that is not there
  std::chrono::milliseconds patience{0};  ///< instead of the device's own, where not 0: for fault drills
  UploadMemory upload_memory = UploadMemory::Auto;
  /// Folder of the kernels compiled before. "auto": FACET_KERNEL_CACHE, else facet/ in XDG_CACHE_HOME or in
  /// ~/.cache; empty: none.
  std::string kernel_cache = "auto";
};

/// The folder that this ContextOptions::kernel_cache means; empty: none.
std::filesystem::path kernel_cache_folder(const std::string& option);

/// The compiled kernels that are kept from one start to the next.
struct KernelCacheState {
  std::string file;               ///< empty: none is kept
  std::size_t read_bytes = 0;     ///< of the driver's data, at the start
  std::size_t written_bytes = 0;  ///< last
  std::string why;                ///< what was wrong with the file, or why it could not be written
  std::string ignored;            ///< for people: why what stood there at the start was not read; else empty
};

/// One Vulkan device with one compute queue. Resources, kernels and batches keep the device alive, so they
/// may be destroyed in any order. Any thread may call any function; Batch says what it asks for itself.
class Context {
 public:
  /// Opens a device. Throws Error(NoDevice) where there is no Vulkan loader, no usable device or none of that
  /// name (the message lists what there is and what to install).
  explicit Context(const ContextOptions& options = {});
  ~Context();
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  const DeviceInfo& info() const;

  /// True once any call reported a lost device, or the device hung. It stays lost: make a new Context.
  bool lost() const;
  /// Whether it is lost because it gave no answer within DeviceInfo::patience.
  bool hung() const;

  /// Makes this context behave as after a device loss: for tests of recovery and for fault drills.
  void simulate_loss();

  /// Writes the kernels compiled so far to ContextOptions::kernel_cache, where they are more than it holds;
  /// so does the destructor. For set-up. Never throws: KernelCacheState::why. Not where the device is lost.
  void keep_kernels() noexcept;
  KernelCacheState kernel_cache() const;

  bool validation_active() const;
  /// What the validation layers said (warnings and errors) so far, oldest first, the first 100 of them.
  std::vector<std::string> validation_messages() const;

  const std::shared_ptr<Device>& device() const { return device_; }

 private:
  std::shared_ptr<Device> device_;
};

/// Every Vulkan device of this machine, usable or not, best first, without opening one. Throws
/// Error(NoDevice) where there is no loader; empty where there is no device.
std::vector<DeviceInfo> list_devices(const ContextOptions& options = {});

std::string_view describe(Outcome outcome);
std::string_view describe(DeviceType type);

}  // namespace facet::gpu
