#include "camera/v4l2_camera.hpp"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <system_error>
#include <utility>

#include "camera/driver_count.hpp"
#include "camera/jpeg_decoder.hpp"
#include "camera/live_camera.hpp"
#include "camera/pixel_buffers.hpp"
#include "camera/v4l2_device.hpp"

namespace facet::camera {
namespace {

/// The first frame may take longer than the others: a camera measures light and white first.
constexpr std::int64_t kFirstFramePatience_ns = 5 * kSecond_ns;

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

class V4l2Camera final : public LiveCamera {
 public:
  V4l2Camera(const LiveConfig& config, V4l2Kernel& kernel);

  void expect_frames(bool due) override;

 private:
  /// A dequeued buffer and what was found of it.
  struct Arrived {
    v4l2_buffer buffer{};
    std::uint64_t sequence = 0;
    std::int64_t timestamp_ns = 0;
    bool usable = false;
    bool dated = false;
  };

  bool is_open() const override { return device_ != nullptr; }
  void open() override;
  void close(CameraState why) override;
  bool take(Frame& out) override;
  void wait(std::int64_t until_ns) override;
  std::int64_t now_ns() const override { return kernel_.monotonic_ns(); }
  std::string named(const std::string& what) const override { return config_.device.string() + ": " + what; }
  void wind_watchdog();
  Arrived examine(const v4l2_buffer& buffer);
  std::optional<std::int64_t> driver_time_ns(const v4l2_buffer& buffer, std::int64_t arrived_ns);
  bool is_stale(const v4l2_buffer& buffer) const;
  bool convert(const Arrived& arrived, Frame& out);

  V4l2Kernel& kernel_;
  LiveConfig config_;
  std::int64_t period_ns_;

  // The capturing thread's.
  std::unique_ptr<V4l2Device> device_;
  std::unique_ptr<V4l2Device> gone_;  ///< was unplugged, not closed yet
  JpegDecoder jpeg_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  DriverCount count_;
  unsigned seen_ = 0;  ///< buffers of this stream
};

V4l2Camera::V4l2Camera(const LiveConfig& config, V4l2Kernel& kernel)
    : LiveCamera(Pauses{}),
      kernel_(kernel),
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
    note_fault(fault);
  }
}

void V4l2Camera::expect_frames(bool due) {
  if (std::exchange(frames_due_, due) != due) {
    if (due) {
      count_.resume();
    }
    wind_watchdog();
  }
}

void V4l2Camera::wind_watchdog() {
  const std::int64_t patience_ns = in_ns(config_.stall_after);
  watchdog_ns_ = frames_due_ ? now_ns() + (first_of_stream_ ? std::max(patience_ns, kFirstFramePatience_ns)
                                                            : patience_ns)
                             : std::numeric_limits<std::int64_t>::max();
}

/// A device that is gone is closed only when it is looked for again: kernels (6.1, uvcvideo) may die of a
/// close while they still take the device down.
void V4l2Camera::close(CameraState why) {
  gone_ = why == CameraState::Absent ? std::move(device_) : nullptr;
  device_.reset();
}

void V4l2Camera::open() {
  gone_.reset();
  auto device = std::make_unique<V4l2Device>(kernel_, config_.device.string());
  device->start(config_);
  device_ = std::move(device);
  count_.begin_stream();
  seen_ = 0;
  last_life_ns_ = now_ns();
  wind_watchdog();
}

void V4l2Camera::wait(std::int64_t until_ns) {
  if (device_ != nullptr) {
    device_->wait(until_ns);
  } else {
    kernel_.wait(-1, until_ns);
  }
}

/// Empties the driver's queue and converts the newest usable frame in it; false where there is none.
bool V4l2Camera::take(Frame& out) {
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
    count(&CameraCounters::damaged, frame.corrupt ? 1 : 0);
    count(&CameraCounters::undated, newest->dated ? 0 : 1);
    note_delivery(frame);
    wind_watchdog();
    out = std::move(frame);
  }
  return converted;
}

V4l2Camera::Arrived V4l2Camera::examine(const v4l2_buffer& buffer) {
  const std::int64_t arrived_ns = now_ns();
  const std::optional<std::int64_t> driver_ns = driver_time_ns(buffer, arrived_ns);
  const DriverCount::Step step = count_.next(buffer.sequence, driver_ns);
  count(&CameraCounters::lost, step.lost);
  count(&CameraCounters::omitted, step.omitted);

  Arrived arrived;
  arrived.buffer = buffer;
  arrived.sequence = step.sequence;
  arrived.dated = driver_ns.has_value();
  const bool at_start = (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  arrived.timestamp_ns = driver_ns.value_or(arrived_ns) - (at_start && driver_ns ? 0 : period_ns_);

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
std::optional<std::int64_t> V4l2Camera::driver_time_ns(const v4l2_buffer& buffer, std::int64_t arrived_ns) {
  const std::optional<std::int64_t> stamp = stamp_ns(buffer);
  if (!stamp) {
    return std::nullopt;
  }
  // Drivers that do not say their clock use that of the day.
  const bool monotonic = (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  return monotonic_stamp_ns(*stamp, device_->started_ns(), arrived_ns,
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
    convert_to_rgba({.layout = *format.layout,
                     .coding = format.coding,
                     .bytes = payload.data(),
                     .stride_bytes = format.stride_bytes,
                     .width_px = config_.width_px,
                     .height_px = config_.height_px,
                     .chroma = chroma.empty() ? nullptr : chroma.data()},
                    pixels.get(), stride);
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
  date(out, arrived.timestamp_ns);
  out.width_px = config_.width_px;
  out.height_px = config_.height_px;
  out.stride_bytes = stride;
  out.corrupt = damaged;
  out.pixels = std::move(pixels);
  return true;
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
        found.push_back({path, "", path + ": " + fault.what(), ""});
      }
    }
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.path < b.path; });
  return found;
}

namespace {

constexpr CameraSetting kSettings[] = {
    {"device", &at<&CameraConfig::live, &LiveConfig::device>},
    {"format", &at<&CameraConfig::live, &LiveConfig::format>, 0, 0, 1, kV4l2Formats},
    {"gain", &at<&CameraConfig::live, &LiveConfig::gain>, -1'000'000, 1'000'000},
    kWidthSetting,
    kHeightSetting,
    kRateSetting,
    kExposureSetting,
    kWhiteBalanceSetting,
    kTurnSetting,
    kMirrorSetting,
    kBuffersSetting,
    kStallAfterSetting,
};

std::vector<FoundCamera> list_for_people() {
  std::vector<FoundCamera> found;
  for (const V4l2Description& device : list_v4l2_devices()) {
    found.push_back({device.card.empty() ? device.modes
                                         : fmt::format("{} ({}): {}", device.path, device.card, device.modes),
                     device.controls.empty() ? "" : fmt::format("{}: {}", device.path, device.controls)});
  }
  return found;
}

}  // namespace

constexpr CameraKind kV4l2Camera = {
    .name = "v4l2",
    .settings = kSettings,
    .has_controls = true,
    .needs = "device",
    .advice = "name the camera that faces come from, such as /dev/v4l/by-path/...; `facet doctor` lists them",
    .open = [](const CameraConfig& config) { return open_v4l2_camera(config.live); },
    .list = list_for_people,
};

}  // namespace facet::camera
