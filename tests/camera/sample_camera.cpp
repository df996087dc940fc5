#include "sample_camera.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <mutex>
#include <string>
#include <thread>

#include "camera/driver_count.hpp"
#include "camera/pixel_buffers.hpp"
#include "camera/pixel_conversion.hpp"
#include "facet/error.hpp"

namespace facet::sample {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kShortestPause{250};
constexpr milliseconds kLongestPause{2000};

class SampleCamera final : public Camera {
 public:
  SampleCamera(const SampleConfig& config, SampleDevice& device);
  ~SampleCamera() override { close(); }

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override { started_ = true; }
  CaptureOutcome next(Frame& out, milliseconds timeout) override;
  void restart(const std::string& why) override;
  void expect_frames(bool due) override;
  void stop() override;
  std::string last_error() const override;

 private:
  bool reopen(Clock::time_point deadline);
  bool take_newest(Frame& out, milliseconds patience);
  Frame convert(const SampleDevice::Picture& picture, std::uint64_t sequence);
  void give_up(CameraState state, const std::string& reason);
  void close();
  void set_state(CameraState state, const std::string& reason);

  SampleDevice& device_;
  SampleConfig config_;
  CameraInfo info_;

  // The capturing thread's.
  bool started_ = false;
  bool stopped_ = false;
  bool open_ = false;
  bool frames_due_ = true;
  Clock::time_point retry_;       ///< while it is closed: when it is opened again
  Clock::time_point last_frame_;  ///< or when it was opened
  milliseconds pause_ = kShortestPause;
  camera::DriverCount count_;
  std::shared_ptr<camera::PixelBuffers> pool_ = std::make_shared<camera::PixelBuffers>();
  bool first_of_stream_ = true;
  std::optional<std::int64_t> first_timestamp_ns_;

  mutable std::mutex shown_mutex_;
  CameraStatus status_;     // guarded by shown_mutex_
  std::string last_error_;  // guarded by shown_mutex_
};

// Match: what is there is checked once, before anything is set; what is not there is a state.
SampleCamera::SampleCamera(const SampleConfig& config, SampleDevice& device)
    : device_(device), config_(config), count_(std::llround(1e9 / config.rate_hz)) {
  info_.name = "sample camera";
  info_.width_px = config.width_px;
  info_.height_px = config.height_px;
  info_.rate_hz = config.rate_hz;
  info_.live = true;
  if (!device_.is_there()) {
    set_state(CameraState::Absent, "sample camera: no such device");
    return;
  }
  const std::vector<double> rates_hz = device_.rates_hz();
  if (std::find(rates_hz.begin(), rates_hz.end(), config.rate_hz) == rates_hz.end()) {
    throw Error(ErrorKind::Usage, fmt::format("sample camera: rate_hz = {}: the camera has {}",
                                              config.rate_hz, fmt::join(rates_hz, ", ")));
  }
}

// Deliver: wait for a picture, for the time given at most; whatever goes wrong becomes a state.
CaptureOutcome SampleCamera::next(Frame& out, milliseconds timeout) {
  if (!started_ || stopped_) {
    return CaptureOutcome::EndOfStream;
  }
  const Clock::time_point deadline = Clock::now() + timeout;
  try {
    while (open_ || reopen(deadline)) {
      const auto left = std::chrono::duration_cast<milliseconds>(deadline - Clock::now());
      if (take_newest(out, std::max(left, milliseconds(0)))) {
        return CaptureOutcome::Delivered;
      }
      if (frames_due_ && Clock::now() - last_frame_ >= config_.stall_after) {
        give_up(CameraState::Stalled, fmt::format("no frame for {} ms", config_.stall_after.count()));
      }
      if (Clock::now() >= deadline) {
        break;
      }
    }
  } catch (const std::exception& fault) {
    give_up(device_.is_there() ? CameraState::Failing : CameraState::Absent, fault.what());
  }
  return CaptureOutcome::Timeout;
}

// Start: buffers and settings, then the stream. A state of trouble stays until the first frame.
bool SampleCamera::reopen(Clock::time_point deadline) {
  if (Clock::now() < retry_) {
    std::this_thread::sleep_until(std::min(retry_, deadline));
    if (deadline < retry_) {
      return false;
    }
  }
  device_.open(config_.rate_hz);
  open_ = true;
  first_of_stream_ = true;
  count_.begin_stream();
  last_frame_ = Clock::now();
  if (const CameraState state = status().state; state == CameraState::Idle || state == CameraState::Absent) {
    set_state(CameraState::Opening, "");
  }
  return true;
}

// A live source hands out the newest picture; the others are counted.
bool SampleCamera::take_newest(Frame& out, milliseconds patience) {
  std::optional<SampleDevice::Picture> newest;
  camera::DriverCount::Step step;
  CameraCounters seen;
  while (auto picture = device_.take(newest ? milliseconds(0) : patience)) {
    seen.skipped += newest ? 1 : 0;
    step = count_.next(picture->number, picture->exposed_ns);
    seen.lost += step.lost;
    seen.omitted += step.omitted;
    newest = std::move(picture);
  }
  if (!newest) {
    return false;
  }
  out = convert(*newest, step.sequence);
  last_frame_ = Clock::now();
  pause_ = kShortestPause;
  const std::scoped_lock lock(shown_mutex_);
  CameraCounters& counters = status_.counters;
  counters.skipped += seen.skipped;
  counters.lost += seen.lost;
  counters.omitted += seen.omitted;
  counters.reopened += first_of_stream_ && counters.delivered > 0 ? 1 : 0;
  ++counters.delivered;
  first_of_stream_ = false;
  status_.state = CameraState::Streaming;
  status_.reason.clear();
  return true;
}

// Convert at the door: 8-bit R G B A, from a pool, so that nothing is allocated while it runs.
Frame SampleCamera::convert(const SampleDevice::Picture& picture, std::uint64_t sequence) {
  const auto stride = static_cast<std::size_t>(camera::rgba_stride_bytes(config_.width_px));
  auto pixels = pool_->take(stride * static_cast<std::size_t>(config_.height_px));
  camera::ColourCoding coding;
  coding.full_range = true;
  camera::convert_to_rgba(camera::PixelLayout::Grey, coding, picture.grey.data(),
                          static_cast<std::size_t>(config_.width_px), config_.width_px, config_.height_px,
                          pixels.get(), stride);
  Frame frame;
  frame.sequence = sequence;
  frame.timestamp_ns = picture.exposed_ns;
  frame.media_time_ns = picture.exposed_ns - first_timestamp_ns_.value_or(picture.exposed_ns);
  first_timestamp_ns_ = first_timestamp_ns_.value_or(picture.exposed_ns);
  frame.width_px = config_.width_px;
  frame.height_px = config_.height_px;
  frame.stride_bytes = stride;
  frame.pixels = std::move(pixels);
  return frame;
}

// Recover: closed, and opened again after a pause that grows.
void SampleCamera::give_up(CameraState state, const std::string& reason) {
  close();
  retry_ = Clock::now() + pause_;
  pause_ = std::min(2 * pause_, kLongestPause);
  set_state(state, "sample camera: " + reason);
}

void SampleCamera::restart(const std::string& why) {
  if (open_) {
    give_up(CameraState::Failing, why);
  }
}

// Silence is a fault while frames are due; they are not while the trigger stands still that the camera hangs
// on.
void SampleCamera::expect_frames(bool due) {
  if (due && !frames_due_) {
    count_.resume();
    last_frame_ = Clock::now();
  }
  frames_due_ = due;
}

void SampleCamera::close() {
  if (std::exchange(open_, false)) {
    device_.close();
  }
}

void SampleCamera::stop() {
  stopped_ = true;
  close();
  set_state(CameraState::Idle, "");
}

CameraStatus SampleCamera::status() const {
  const std::scoped_lock lock(shown_mutex_);
  return status_;
}

std::string SampleCamera::last_error() const {
  const std::scoped_lock lock(shown_mutex_);
  return last_error_;
}

void SampleCamera::set_state(CameraState state, const std::string& reason) {
  const std::scoped_lock lock(shown_mutex_);
  status_.state = state;
  status_.reason = reason;
  if (!reason.empty()) {
    last_error_ = reason;
  }
}

}  // namespace

std::unique_ptr<Camera> open_sample_camera(const SampleConfig& config, SampleDevice& device) {
  return std::make_unique<SampleCamera>(config, device);
}

}  // namespace facet::sample
