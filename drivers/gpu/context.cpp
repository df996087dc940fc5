#include "gpu/context.hpp"

#include "gpu/device.hpp"
#include "gpu/software_threads.hpp"

namespace facet::gpu {

Context::Context(const ContextOptions& options) : device_(std::make_shared<Device>(options)) {
  if (device_->info().is_software && options.pin_software_threads) {
    pin_software_threads();
  }
}

Context::~Context() {
  keep_kernels();
}

void Context::keep_kernels() noexcept {
  if (!device_->lost()) {
    device_->kernel_cache().keep();
  }
}

KernelCacheState Context::kernel_cache() const {
  return device_->kernel_cache().state();
}

const DeviceInfo& Context::info() const {
  return device_->info();
}

bool Context::lost() const {
  return device_->lost();
}

bool Context::hung() const {
  return device_->hung();
}

void Context::simulate_loss() {
  device_->mark_lost();
}

bool Context::validation_active() const {
  return device_->instance().validation_active();
}

std::vector<std::string> Context::validation_messages() const {
  return device_->instance().validation_messages();
}

std::vector<DeviceInfo> list_devices(const ContextOptions& options) {
  const Instance instance(options);
  std::vector<DeviceInfo> infos;
  for (Instance::Candidate& candidate : instance.candidates()) {
    infos.push_back(std::move(candidate.info));
  }
  return infos;
}

std::string_view describe(Outcome outcome) {
  switch (outcome) {
    case Outcome::Done:
      return "done";
    case Outcome::TimedOut:
      return "timed out";
    case Outcome::DeviceLost:
      return "device lost";
  }
  return "unknown";
}

std::string_view describe(DeviceType type) {
  switch (type) {
    case DeviceType::Discrete:
      return "discrete GPU";
    case DeviceType::Integrated:
      return "integrated GPU";
    case DeviceType::Virtual:
      return "virtual GPU";
    case DeviceType::Software:
      return "software";
  }
  return "unknown";
}

}  // namespace facet::gpu
