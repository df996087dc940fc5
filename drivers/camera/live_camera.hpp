#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "camera/device_fault.hpp"
#include "facet/camera.hpp"
#include "facet/mutex.hpp"

namespace facet::camera {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

inline std::int64_t in_ns(std::chrono::milliseconds time) {
  return std::chrono::nanoseconds(time).count();
}

inline double in_s(std::int64_t time_ns) {
  return static_cast<double>(time_ns) / static_cast<double>(kSecond_ns);
}

/// What every live camera does: it shows its state and counts, opens its device with the first `next` and
/// anew after every fault, with pauses that grow, and takes silence for one. A driver says how its device is
/// opened and read; whatever it throws meanwhile becomes a state with a reason, and `next` says Timeout.
///
/// All but info, status and last_error belongs to the capturing thread.
class LiveCamera : public Camera {
 public:
  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override;
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override;
  void restart(const std::string& why) override;
  void stop() override;
  std::string last_error() const override;

 protected:
  /// Between two attempts to open the device.
  struct Pauses {
    std::chrono::milliseconds shortest{250};  ///< after a fault; doubled each time
    std::chrono::milliseconds longest{2'000};
    std::chrono::milliseconds absent{250};  ///< between two looks for a device that is not there
    std::chrono::milliseconds proven{0};    ///< a stream that delivered and lasted so long: they begin anew
  };
  explicit LiveCamera(const Pauses& pauses) : pauses_(pauses), pause_ns_(in_ns(pauses.shortest)) {}

  // The driver's.
  virtual bool is_open() const = 0;
  /// Opens the device and sets watchdog_ns_.
  virtual void open() = 0;
  /// Lets go of the device, if there is one. why: Idle where the camera is stopped, else what it is now.
  virtual void close(CameraState why) = 0;
  /// The newest frame that has come, and note_delivery; false where there is none. Never waits.
  virtual bool take(Frame& out) = 0;
  /// Until the device has something to tell or the time has come; the time alone where it is closed.
  virtual void wait(std::int64_t until_ns) = 0;
  virtual std::int64_t now_ns() const;
  /// A fault's sentence with the name of the camera.
  virtual std::string named(const std::string& what) const { return info_.name + ": " + what; }
  /// Why it is taken for stalled.
  virtual std::string silence(double silent_s) const;

  // For the driver.
  void set_state(CameraState state, const std::string& reason);
  /// A fault that was found before the start. Throws Error(Usage) where the device can't do what is asked of
  /// it.
  void note_fault(const DeviceFault& fault);
  /// Closes the device; it is opened again after a pause.
  void give_up(CameraState state, const std::string& what);
  void count(std::uint64_t CameraCounters::*which, std::uint64_t how_many = 1);
  /// Sets the times of a frame: later than those of the frame before.
  void date(Frame& frame, std::int64_t exposed_ns);
  void note_delivery(const Frame& frame);

  CameraInfo info_;
  bool frames_due_ = true;
  bool delivered_before_ = false;  ///< anything, by this stream or one before
  bool first_of_stream_ = true;    ///< nothing was delivered since the device was opened
  std::int64_t begun_ns_ = 0;      ///< when the device was opened
  std::int64_t last_life_ns_ = 0;  ///< the last delivery, or when the device was opened
  std::int64_t watchdog_ns_ = 0;   ///< the device is taken for stalled when no frame has come until then

  mutable Mutex shown_mutex_;
  CameraStatus status_ FACET_GUARDED_BY(shown_mutex_);
  std::string last_error_ FACET_GUARDED_BY(shown_mutex_);

 private:
  bool reopen(std::int64_t deadline_ns);

  Pauses pauses_;
  bool started_ = false;
  bool stopped_ = false;
  std::int64_t retry_ns_ = 0;  ///< while it is closed: when it is opened again
  std::int64_t pause_ns_;
  std::int64_t timestamp_ns_ = 0;  ///< of the newest frame
  std::int64_t first_timestamp_ns_ = 0;
};

}  // namespace facet::camera
