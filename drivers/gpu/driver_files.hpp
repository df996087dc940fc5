#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "gpu/context.hpp"

namespace facet::gpu {

/// Where the files of drivers are looked for; tests give a folder and an environment of their own.
struct DriverPlaces {
  std::filesystem::path root = "/";
  std::string library_path;  ///< LD_LIBRARY_PATH
  std::string manifests;     ///< VK_DRIVER_FILES or VK_ICD_FILENAMES: where set, the only manifests

  /// This process's.
  static DriverPlaces here();
};

/// Why GPUs that this machine has are no Vulkan devices: one sentence each, naming the first thing that is
/// missing (kernel module, device node, library, manifest, right) and what to do. Empty where every GPU is
/// among the devices found, or no other is seen. Looks at files alone. Any thread.
std::vector<std::string> what_gpus_lack(const std::vector<DeviceInfo>& found,
                                        const DriverPlaces& places = DriverPlaces::here());

}  // namespace facet::gpu
