#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace facet::test {

/// The faults that fault_layer/fault_layer.cpp gives a device, in a file that it reads anew at every call.
/// Link ROOMS test_gpu_faults.
class GpuFaults {
 public:
  /// one a line; empty: the device is whole.
  void set(const std::string& faults) const {
    // In one go, since another thread or process may read at any time.
    const std::filesystem::path next = folder_.path() / "next";
    std::ofstream(next) << faults << '\n';
    std::filesystem::rename(next, file());
  }

  /// "NAME=VALUE" for a process whose devices shall have them.
  std::vector<std::string> environment() const {
    return {"VK_LAYER_PATH=" FAULT_LAYER_FOLDER, "VK_INSTANCE_LAYERS=VK_LAYER_FACET_fault",
            "FACET_GPU_FAULTS=" + file().string()};
  }

 protected:
  std::filesystem::path file() const { return folder_.path() / "faults"; }

 private:
  TemporaryFolder folder_;
};

/// The same for the devices that this process opens while it lives.
class OwnGpuFaults : public GpuFaults {
 public:
  explicit OwnGpuFaults(const std::string& faults = {}) {
    set(faults);
    for (const std::string& variable : environment()) {
      const std::size_t name_end = variable.find('=');
      ::setenv(variable.substr(0, name_end).c_str(), variable.c_str() + name_end + 1, 1);
    }
  }
  ~OwnGpuFaults() {
    for (const char* name : {"VK_LAYER_PATH", "VK_INSTANCE_LAYERS", "FACET_GPU_FAULTS"}) {
      ::unsetenv(name);
    }
  }
  OwnGpuFaults(const OwnGpuFaults&) = delete;
  OwnGpuFaults& operator=(const OwnGpuFaults&) = delete;
};

}  // namespace facet::test
