#include "simulation/simulated_camera.hpp"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <exception>
#include <mutex>
#include <string>
#include <utility>

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

  CameraStatus status() const override {
    const std::lock_guard lock(mutex_);
    return status_;
  }

  void start() override {
    running_ = true;
    start_ns_ = monotonic_ns();
    set_state(CameraState::Opening);
  }

  CaptureOutcome next(Frame& out, std::chrono::milliseconds /*timeout*/) override {
    if (!running_) {
      return CaptureOutcome::EndOfStream;
    }
    if (next_index_ >= studio_.config().frame_count) {
      set_state(CameraState::Ended);
      return CaptureOutcome::EndOfStream;
    }
    try {
      out = render::to_frame(studio_.render(next_index_, nullptr).picture);
    } catch (const std::exception& failure) {
      set_state(CameraState::Failing, failure.what());
      return CaptureOutcome::Failed;
    }
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    out.sequence = static_cast<std::uint64_t>(next_index_);
    out.media_time_ns = next_index_ * kSecond_ns / studio_.config().rate_hz;
    out.timestamp_ns = std::max(start_ns_ + out.media_time_ns, monotonic_ns());
    ++next_index_;
    const std::lock_guard lock(mutex_);
    status_.state = CameraState::Streaming;
    ++status_.counters.delivered;
    return CaptureOutcome::Delivered;
  }

  void stop() override {
    running_ = false;
    set_state(CameraState::Idle);
  }

  std::string last_error() const override { return status().reason; }

 private:
  void set_state(CameraState state, std::string reason = {}) {
    const std::lock_guard lock(mutex_);
    status_.state = state;
    status_.reason = std::move(reason);
  }

  Studio studio_;
  bool running_ = false;
  int next_index_ = 0;
  std::int64_t start_ns_ = 0;
  mutable std::mutex mutex_;
  CameraStatus status_;  // guarded by mutex_
};

}  // namespace

std::unique_ptr<Camera> make_simulated_camera(const face::FaceModel& model, const StudioConfig& config) {
  return std::make_unique<SimulatedCamera>(model, config);
}

}  // namespace facet::simulation
