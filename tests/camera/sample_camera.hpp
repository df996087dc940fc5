#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "facet/camera.hpp"

// The sample driver of docs/adding-a-camera.md: complete, and as small as a driver can be.

namespace facet::sample {

/// What the driver drives: a grey camera as a vendor's library would show it. A driver for a real one has
/// that library here, behind as thin an interface, so that tests can break it.
class SampleDevice {
 public:
  struct Picture {
    std::uint32_t number = 0;        ///< counts what the sensor exposed; wraps
    std::int64_t exposed_ns = 0;     ///< CLOCK_MONOTONIC at the start of exposure
    std::vector<std::uint8_t> grey;  ///< [height_px][width_px]
  };

  SampleDevice() = default;
  SampleDevice(const SampleDevice&) = delete;
  SampleDevice& operator=(const SampleDevice&) = delete;
  virtual ~SampleDevice() = default;

  virtual bool is_there() = 0;
  virtual std::vector<double> rates_hz() = 0;
  /// Throws camera::DeviceFault where the device refuses or is not there.
  virtual void open(double rate_hz) = 0;
  virtual void close() = 0;
  /// The oldest picture that nobody has taken, awaited for `timeout` at most. Throws camera::DeviceFault
  /// where the device is gone or broken.
  virtual std::optional<Picture> take(std::chrono::milliseconds timeout) = 0;
};

struct SampleConfig {
  int width_px = 64;
  int height_px = 48;
  double rate_hz = 30;
  std::chrono::milliseconds stall_after{2000};
};

/// Opens a camera. Throws Error(Usage) where the device is there and has no such rate; the message lists
/// those it has. The device outlives the camera.
std::unique_ptr<Camera> open_sample_camera(const SampleConfig& config, SampleDevice& device);

}  // namespace facet::sample
