#include "camera/v4l2_camera.hpp"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <mutex>
#include <optional>
#include <system_error>
#include <utility>

#include "camera/driver_count.hpp"
#include "camera/jpeg_decoder.hpp"
#include "camera/pixel_buffers.hpp"
#include "camera/v4l2_device.hpp"
#include "facet/error.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
/// Between two looks for an absent device; a look is one failing system call.
constexpr std::int64_t kAbsentPause_ns = kSecond_ns / 4;
/// Between two attempts to open a device that refuses; doubled each time.
constexpr std::int64_t kShortestPause_ns = kSecond_ns / 4;
constexpr std::int64_t kLongestPause_ns = 2 * kSecond_ns;
/// The first frame may take longer than the others: a camera measures light and white first.
constexpr std::int64_t kFirstFramePatience_ns = 5 * kSecond_ns;

std::int64_t in_ns(std::chrono::milliseconds time) {
  return std::chrono::nanoseconds(time).count();
}

/// The time of a buffer as it stands there; none where it is no time of this century or the last.
std::optional<std::int64_t> stamp_ns(const v4l2_buffer& buffer) {
  constexpr std::int64_t kMost_s = 1LL << 32;
  const std::int64_t seconds = buffer.timestamp.tv_sec;
  const std::int64_t microseconds = buffer.timestamp.tv_usec;
  if (seconds < 0 || seconds > kMost_s || microseconds < 0 || microseconds >= 1'000'000) {
    return std::nullopt;
  }
  return seconds * kSecond_ns + microseconds * 1000;
}

class V4l2Camera final : public Camera {
 public:
  V4l2Camera(const LiveConfig& config, V4l2Kernel& kernel);

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override;
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override;
  void restart(const std::string& why) override;
  void expect_frames(bool due) override;
  void stop() override;
  std::string last_error() const override;

 private:
  /// A dequeued buffer and what was found of it.
  struct Arrived {
    v4l2_buffer buffer{};
    std::uint64_t sequence = 0;
    std::int64_t timestamp_ns = 0;
    bool usable = false;
    bool dated = false;
  };

  bool reopen(std::int64_t deadline_ns);
  void wind_watchdog();
  bool take_newest(Frame& out);
  Arrived examine(const v4l2_buffer& buffer);
  std::optional<std::int64_t> driver_time_ns(const v4l2_buffer& buffer, std::int64_t now_ns);
  bool is_stale(const v4l2_buffer& buffer) const;
  bool convert(const Arrived& arrived, Frame& out);
  void note_delivery(const Arrived& arrived, const Frame& frame);
  void give_up(CameraState state, const std::string& reason);
  void set_state(CameraState state, const std::string& reason);
  void count(std::uint64_t CameraCounters::*which, std::uint64_t how_many = 1);

  V4l2Kernel& kernel_;
  LiveConfig config_;
  CameraInfo info_;
  std::int64_t period_ns_;

  // The capturing thread's.
  bool started_ = false;
  bool stopped_ = false;
  std::unique_ptr<V4l2Device> device_;
  std::unique_ptr<V4l2Device> gone_;  ///< was unplugged, not closed yet
  JpegDecoder jpeg_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  std::int64_t retry_ns_ = 0;      ///< while there is no device: when it is opened again
  std::int64_t last_life_ns_ = 0;  ///< the last delivery, or when the stream was begun
  bool frames_due_ = true;
  std::int64_t watchdog_ns_ = 0;  ///< the stream is taken for stalled when no frame has come until then
  std::int64_t pause_ns_ = kShortestPause_ns;
  bool delivered_before_ = false;  ///< anything, by this stream or one before
  bool first_of_stream_ = true;    ///< nothing was delivered by this stream
  DriverCount count_;
  unsigned seen_ = 0;              ///< buffers of this stream
  std::int64_t timestamp_ns_ = 0;  ///< of the newest delivered frame
  std::int64_t first_timestamp_ns_ = 0;

  mutable std::mutex shown_mutex_;
  CameraStatus status_;     // guarded by shown_mutex_
  std::string last_error_;  // guarded by shown_mutex_
};

V4l2Camera::V4l2Camera(const LiveConfig& config, V4l2Kernel& kernel)
    : kernel_(kernel),
      config_(config),
      period_ns_(std::llround(static_cast<double>(kSecond_ns) / config.rate_hz)),
      count_(period_ns_) {
  info_.name = config.device.string();
  info_.width_px = config.width_px;
  info_.height_px = config.height_px;
  info_.rate_hz = config.rate_hz;
  info_.live = true;
  try {
    const V4l2Device device(kernel_, config_.device.string());
    info_.name += fmt::format(" ({})", device.card());
    device.check(config_);
  } catch (const DeviceFault& fault) {
    if (fault.kind == DeviceFault::Kind::Unsuitable) {
      throw Error(ErrorKind::Usage, fault.what());
    }
    set_state(fault.kind == DeviceFault::Kind::Absent ? CameraState::Absent : CameraState::Failing,
              fault.what());
  }
}

void V4l2Camera::start() {
  if (!started_) {
    started_ = true;
    retry_ns_ = kernel_.monotonic_ns();
  }
}

void V4l2Camera::restart(const std::string& why) {
  if (device_ != nullptr) {
    give_up(CameraState::Failing, fmt::format("{}: {}", config_.device.string(), why));
  }
}

void V4l2Camera::expect_frames(bool due) {
  if (due && !frames_due_) {
    count_.resume();
    wind_watchdog();
  }
  frames_due_ = due;
}

void V4l2Camera::wind_watchdog() {
  const std::int64_t patience_ns = in_ns(config_.stall_after);
  watchdog_ns_ = kernel_.monotonic_ns() +
                 (first_of_stream_ ? std::max(patience_ns, kFirstFramePatience_ns) : patience_ns);
}

void V4l2Camera::stop() {
  stopped_ = true;
  device_.reset();
  gone_.reset();
  set_state(CameraState::Idle, "");
}

CameraStatus V4l2Camera::status() const {
  const std::scoped_lock lock(shown_mutex_);
  return status_;
}

std::string V4l2Camera::last_error() const {
  const std::scoped_lock lock(shown_mutex_);
  return last_error_;
}

void V4l2Camera::set_state(CameraState state, const std::string& reason) {
  const std::scoped_lock lock(shown_mutex_);
  status_.state = state;
  status_.reason = reason;
  if (!reason.empty()) {
    last_error_ = reason;
  }
}

void V4l2Camera::count(std::uint64_t CameraCounters::*which, std::uint64_t how_many) {
  const std::scoped_lock lock(shown_mutex_);
  status_.counters.*which += how_many;
}

CaptureOutcome V4l2Camera::next(Frame& out, std::chrono::milliseconds timeout) {
  if (!started_ || stopped_) {
    return CaptureOutcome::EndOfStream;
  }
  const std::int64_t deadline_ns = kernel_.monotonic_ns() + in_ns(timeout);
  try {
    while (device_ != nullptr || reopen(deadline_ns)) {
      if (take_newest(out)) {
        return CaptureOutcome::Delivered;
      }
      const std::int64_t now_ns = kernel_.monotonic_ns();
      if (frames_due_ && now_ns >= watchdog_ns_) {
        give_up(CameraState::Stalled,
                fmt::format("{}: no frame for {:.3g} s", config_.device.string(),
                            static_cast<double>(now_ns - last_life_ns_) / static_cast<double>(kSecond_ns)));
        break;
      }
      if (now_ns >= deadline_ns) {
        break;
      }
      device_->wait(frames_due_ ? std::min(deadline_ns, watchdog_ns_) : deadline_ns);
    }
  } catch (const DeviceFault& fault) {
    give_up(fault.kind == DeviceFault::Kind::Absent ? CameraState::Absent : CameraState::Failing,
            fault.what());
  } catch (const std::exception& fault) {
    give_up(CameraState::Failing, fmt::format("{}: {}", config_.device.string(), fault.what()));
  }
  return CaptureOutcome::Timeout;
}

/// Lets go of the device; it is opened again after a pause. One that is gone is closed only then: kernels
/// (6.1, uvcvideo) may die of a close while they still take the device down.
void V4l2Camera::give_up(CameraState state, const std::string& reason) {
  gone_ = state == CameraState::Absent ? std::move(device_) : nullptr;
  device_.reset();
  std::int64_t pause_ns = kAbsentPause_ns;
  if (state != CameraState::Absent) {
    pause_ns = pause_ns_;
    pause_ns_ = std::min(2 * pause_ns_, kLongestPause_ns);
  }
  retry_ns_ = kernel_.monotonic_ns() + pause_ns;
  set_state(state, reason);
}

/// Opens the device when its time has come; false where that is after the deadline.
bool V4l2Camera::reopen(std::int64_t deadline_ns) {
  if (kernel_.monotonic_ns() < retry_ns_) {
    kernel_.wait(-1, std::min(retry_ns_, deadline_ns));
    if (deadline_ns < retry_ns_) {
      return false;
    }
  }
  gone_.reset();
  auto device = std::make_unique<V4l2Device>(kernel_, config_.device.string());
  device->start(config_);
  device_ = std::move(device);
  count_.begin_stream();
  seen_ = 0;
  first_of_stream_ = true;
  last_life_ns_ = kernel_.monotonic_ns();
  wind_watchdog();
  // A device that stalled or failed shows with its first frame whether it is well again.
  if (const CameraState state = status().state; state == CameraState::Idle || state == CameraState::Absent) {
    set_state(CameraState::Opening, "");
  }
  return true;
}

/// Empties the driver's queue and converts the newest usable frame in it; false where there is none.
bool V4l2Camera::take_newest(Frame& out) {
  std::optional<Arrived> newest;
  for (unsigned i = 0; i < device_->buffer_count(); ++i) {
    const std::optional<v4l2_buffer> buffer = device_->dequeue();
    if (!buffer) {
      break;
    }
    const Arrived arrived = examine(*buffer);
    if (!arrived.usable) {
      device_->queue(buffer->index);
      continue;
    }
    if (newest) {
      count(&CameraCounters::skipped);
      device_->queue(newest->buffer.index);
    }
    newest = arrived;
  }
  if (!newest) {
    return false;
  }
  Frame frame;
  const bool converted = convert(*newest, frame);
  device_->queue(newest->buffer.index);
  if (converted) {
    note_delivery(*newest, frame);
    out = std::move(frame);
  }
  return converted;
}

V4l2Camera::Arrived V4l2Camera::examine(const v4l2_buffer& buffer) {
  const std::int64_t now_ns = kernel_.monotonic_ns();
  const std::optional<std::int64_t> driver_ns = driver_time_ns(buffer, now_ns);
  const DriverCount::Step step = count_.next(buffer.sequence, driver_ns);
  count(&CameraCounters::lost, step.lost);
  count(&CameraCounters::omitted, step.omitted);

  Arrived arrived;
  arrived.buffer = buffer;
  arrived.sequence = step.sequence;
  arrived.dated = driver_ns.has_value();
  const bool at_start = (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  arrived.timestamp_ns = driver_ns.value_or(now_ns) - (at_start && driver_ns ? 0 : period_ns_);

  const bool stale = is_stale(buffer);
  ++seen_;
  if (stale) {
    count(&CameraCounters::stale);
    return arrived;
  }
  if (device_->payload(buffer).size() < device_->format().least_bytes ||
      device_->chroma(buffer).size() < device_->format().least_chroma_bytes) {
    count(&CameraCounters::truncated);
    return arrived;
  }
  arrived.usable = true;
  return arrived;
}

/// The driver's time of a buffer in CLOCK_MONOTONIC; none where it can't be one of this stream.
std::optional<std::int64_t> V4l2Camera::driver_time_ns(const v4l2_buffer& buffer, std::int64_t now_ns) {
  const std::optional<std::int64_t> stamp = stamp_ns(buffer);
  if (!stamp) {
    return std::nullopt;
  }
  // Drivers that do not say their clock use that of the day.
  const bool monotonic = (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  return monotonic_stamp_ns(*stamp, device_->started_ns(), now_ns,
                            monotonic ? std::nullopt : std::optional(kernel_.realtime_ns()));
}

/// Whether the buffer was filled before the stream began. A device has as many of these as buffers at most;
/// one that says so of every frame has a clock that is wrong.
bool V4l2Camera::is_stale(const v4l2_buffer& buffer) const {
  const std::optional<std::int64_t> stamp = stamp_ns(buffer);
  return seen_ < device_->buffer_count() && stamp && *stamp < device_->started_ns() &&
         (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
}

bool V4l2Camera::convert(const Arrived& arrived, Frame& out) {
  const V4l2Device::Format& format = device_->format();
  const std::span<const std::uint8_t> payload = device_->payload(arrived.buffer);
  const std::span<const std::uint8_t> chroma = device_->chroma(arrived.buffer);
  const auto stride = static_cast<std::size_t>(rgba_stride_bytes(config_.width_px));
  auto pixels = pool_->take(stride * static_cast<std::size_t>(config_.height_px));
  bool damaged = (arrived.buffer.flags & V4L2_BUF_FLAG_ERROR) != 0;
  if (format.layout) {
    convert_to_rgba(*format.layout, format.coding, payload.data(), format.stride_bytes, config_.width_px,
                    config_.height_px, pixels.get(), stride, chroma.empty() ? nullptr : chroma.data());
  } else {
    const JpegOutcome outcome =
        jpeg_.decode(payload, config_.width_px, config_.height_px, pixels.get(), stride);
    if (outcome == JpegOutcome::Unreadable) {
      count(&CameraCounters::undecodable);
      return false;
    }
    damaged = damaged || outcome == JpegOutcome::Damaged;
  }
  out.sequence = arrived.sequence;
  out.timestamp_ns = arrived.timestamp_ns;
  if (delivered_before_) {
    out.timestamp_ns = std::max(out.timestamp_ns, timestamp_ns_ + 1);
  } else {
    first_timestamp_ns_ = out.timestamp_ns;
  }
  out.media_time_ns = out.timestamp_ns - first_timestamp_ns_;
  out.width_px = config_.width_px;
  out.height_px = config_.height_px;
  out.stride_bytes = stride;
  out.corrupt = damaged;
  out.pixels = std::move(pixels);
  return true;
}

void V4l2Camera::note_delivery(const Arrived& arrived, const Frame& frame) {
  timestamp_ns_ = frame.timestamp_ns;
  last_life_ns_ = kernel_.monotonic_ns();
  pause_ns_ = kShortestPause_ns;
  const std::scoped_lock lock(shown_mutex_);
  CameraCounters& counters = status_.counters;
  ++counters.delivered;
  counters.damaged += frame.corrupt ? 1 : 0;
  counters.undated += arrived.dated ? 0 : 1;
  counters.reopened += delivered_before_ && first_of_stream_ ? 1 : 0;
  delivered_before_ = true;
  first_of_stream_ = false;
  wind_watchdog();
  status_.state = CameraState::Streaming;
  status_.reason.clear();
}

}  // namespace

std::unique_ptr<Camera> open_v4l2_camera(const LiveConfig& config, V4l2Kernel& kernel) {
  return std::make_unique<V4l2Camera>(config, kernel);
}

std::vector<V4l2Description> list_v4l2_devices(const std::filesystem::path& folder, V4l2Kernel& kernel) {
  std::vector<V4l2Description> found;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (!entry->path().filename().string().starts_with("video")) {
      continue;
    }
    const std::string path = entry->path().string();
    try {
      const V4l2Device device(kernel, path);
      found.push_back({path, device.card(), device.offer(), device.controls()});
    } catch (const DeviceFault& fault) {
      if (fault.kind == DeviceFault::Kind::Failing) {
        found.push_back({path, "", fault.what(), ""});
      }
    }
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.path < b.path; });
  return found;
}

}  // namespace facet::camera
