#include "simulation/simulated_camera.hpp"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <exception>
#include <mutex>
#include <string>

namespace facet::simulation {
namespace {

std::int64_t monotonic_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

class SimulatedCamera final : public Camera {
 public:
  SimulatedCamera(const face::FaceModel& model, const StudioConfig& config) : studio_(model, config) {}

  CameraInfo info() const override {
    const StudioConfig& config = studio_.config();
    return {.name = "simulation",
            .width_px = config.width_px,
            .height_px = config.height_px,
            .rate_hz = static_cast<double>(config.rate_hz),
            .live = false,
            .frame_count = static_cast<std::uint64_t>(config.frame_count),
            .intrinsics = studio_.camera()};
  }

  void start() override {
    running_ = true;
    start_ns_ = monotonic_ns();
  }

  CaptureOutcome next(Frame& out, std::chrono::milliseconds /*timeout*/) override {
    if (!running_ || next_index_ >= studio_.config().frame_count) {
      return CaptureOutcome::EndOfStream;
    }
    try {
      out = render::to_frame(studio_.render(next_index_, nullptr).picture);
    } catch (const std::exception& failure) {
      const std::lock_guard lock(mutex_);
      last_error_ = failure.what();
      return CaptureOutcome::Failed;
    }
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    out.sequence = static_cast<std::uint64_t>(next_index_);
    out.media_time_ns = next_index_ * kSecond_ns / studio_.config().rate_hz;
    out.timestamp_ns = std::max(start_ns_ + out.media_time_ns, monotonic_ns());
    ++next_index_;
    return CaptureOutcome::Delivered;
  }

  void stop() override { running_ = false; }

  std::string last_error() const override {
    const std::lock_guard lock(mutex_);
    return last_error_;
  }

 private:
  Studio studio_;
  bool running_ = false;
  int next_index_ = 0;
  std::int64_t start_ns_ = 0;
  mutable std::mutex mutex_;
  std::string last_error_;  // guarded by mutex_
};

}  // namespace

std::unique_ptr<Camera> make_simulated_camera(const face::FaceModel& model, const StudioConfig& config) {
  return std::make_unique<SimulatedCamera>(model, config);
}

}  // namespace facet::simulation
