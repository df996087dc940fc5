#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "camera/factory.hpp"
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

/// What is plugged in, as the library would find it; null: nothing.
SampleDevice*& plugged_in();

/// Opens a camera. Throws Error(Usage) where the device is there and has no such rate; the message lists
/// those it has. The device outlives the camera.
std::unique_ptr<Camera> open_sample_camera(const camera::LiveConfig& config, SampleDevice& device);

/// What camera::camera_kinds() would list.
extern const camera::CameraKind kSampleCamera;

}  // namespace facet::sample
