#include "sample_camera.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "camera/driver_count.hpp"
#include "camera/live_camera.hpp"
#include "camera/pixel_buffers.hpp"
#include "camera/pixel_conversion.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::sample {
namespace {

using std::chrono::milliseconds;

class SampleCamera final : public camera::LiveCamera {
 public:
  SampleCamera(const camera::LiveConfig& config, SampleDevice& device);
  ~SampleCamera() override { SampleCamera::close(CameraState::Idle); }

  void expect_frames(bool due) override;

 private:
  bool is_open() const override { return open_; }
  void open() override;
  void close(CameraState why) override;
  bool take(Frame& out) override;
  void wait(std::int64_t until_ns) override;
  void wind_watchdog();
  Frame convert(const SampleDevice::Picture& picture, std::uint64_t sequence);

  SampleDevice& device_;
  camera::LiveConfig config_;
  bool open_ = false;
  std::optional<SampleDevice::Picture> awaited_;  ///< what wait has taken
  camera::DriverCount count_;
  std::shared_ptr<camera::PixelBuffers> pool_ = std::make_shared<camera::PixelBuffers>();
};

// Match: what is there is checked once, before anything is set; what is not there is a state.
SampleCamera::SampleCamera(const camera::LiveConfig& config, SampleDevice& device)
    : LiveCamera(Pauses{}), device_(device), config_(config), count_(std::llround(1e9 / config.rate_hz)) {
  info_.name = "sample camera";
  info_.width_px = config.width_px;
  info_.height_px = config.height_px;
  info_.rate_hz = config.rate_hz;
  info_.live = true;
  if (!device_.is_there()) {
    set_state(CameraState::Absent, named("no such device"));
    return;
  }
  const std::vector<double> rates_hz = device_.rates_hz();
  if (std::find(rates_hz.begin(), rates_hz.end(), config.rate_hz) == rates_hz.end()) {
    throw Error(ErrorKind::Usage, fmt::format("sample camera: rate_hz = {}: the camera has {}",
                                              config.rate_hz, fmt::join(rates_hz, ", ")));
  }
}

// Start: buffers and settings, then the stream.
void SampleCamera::open() {
  device_.open(config_.rate_hz);
  open_ = true;
  count_.begin_stream();
  wind_watchdog();
}

// Deliver: the newest picture is handed out, the others are counted.
bool SampleCamera::take(Frame& out) {
  std::optional<SampleDevice::Picture> newest;
  camera::DriverCount::Step step;
  auto picture = awaited_ ? std::exchange(awaited_, std::nullopt) : device_.take(milliseconds(0));
  for (; picture; picture = device_.take(milliseconds(0))) {
    count(&CameraCounters::skipped, newest ? 1 : 0);
    step = count_.next(picture->number, picture->exposed_ns);
    count(&CameraCounters::lost, step.lost);
    count(&CameraCounters::omitted, step.omitted);
    newest = std::move(picture);
  }
  if (newest) {
    out = convert(*newest, step.sequence);
    note_delivery(out);
    wind_watchdog();
  }
  return newest.has_value();
}

void SampleCamera::wait(std::int64_t until_ns) {
  if (!open_) {
    Clock::sleep_until(Clock::at(until_ns));
    return;
  }
  const std::chrono::nanoseconds left(std::max<std::int64_t>(until_ns - now_ns(), 0));
  awaited_ = device_.take(std::chrono::ceil<milliseconds>(left));
}

// Convert at the door: 8-bit R G B A, from a pool, so that nothing is allocated while it runs.
Frame SampleCamera::convert(const SampleDevice::Picture& picture, std::uint64_t sequence) {
  const auto stride = static_cast<std::size_t>(camera::rgba_stride_bytes(config_.width_px));
  auto pixels = pool_->take(stride * static_cast<std::size_t>(config_.height_px));
  camera::RawPicture raw;
  raw.layout = camera::PixelLayout::Grey;
  raw.coding.full_range = true;
  raw.bytes = picture.grey.data();
  raw.stride_bytes = static_cast<std::size_t>(config_.width_px);
  raw.width_px = config_.width_px;
  raw.height_px = config_.height_px;
  camera::convert_to_rgba(raw, pixels.get(), stride);
  Frame frame;
  frame.sequence = sequence;
  date(frame, picture.exposed_ns);
  frame.width_px = config_.width_px;
  frame.height_px = config_.height_px;
  frame.stride_bytes = stride;
  frame.pixels = std::move(pixels);
  return frame;
}

// Silence is a fault while frames are due; they are not while the trigger stands still that the camera hangs
// on.
void SampleCamera::expect_frames(bool due) {
  if (std::exchange(frames_due_, due) != due) {
    count_.resume();
    wind_watchdog();
  }
}

void SampleCamera::wind_watchdog() {
  watchdog_ns_ =
      frames_due_ ? now_ns() + camera::in_ns(config_.stall_after) : std::numeric_limits<std::int64_t>::max();
}

// Recover, stop: whatever was wrong, the device is let go of in one way.
void SampleCamera::close(CameraState /*why*/) {
  awaited_.reset();
  if (std::exchange(open_, false)) {
    device_.close();
  }
}

}  // namespace

std::unique_ptr<Camera> open_sample_camera(const camera::LiveConfig& config, SampleDevice& device) {
  return std::make_unique<SampleCamera>(config, device);
}

SampleDevice*& plugged_in() {
  static SampleDevice* device = nullptr;
  return device;
}

namespace {

constexpr camera::CameraSetting kSettings[] = {
    camera::kWidthSetting,
    camera::kHeightSetting,
    camera::kRateSetting,
    camera::kStallAfterSetting,
};

std::unique_ptr<Camera> open(const camera::CameraConfig& config) {
  return open_sample_camera(config.live, *plugged_in());
}

std::vector<camera::FoundCamera> list() {
  if (plugged_in() == nullptr || !plugged_in()->is_there()) {
    return {};
  }
  return {{fmt::format("sample camera: {} Hz", fmt::join(plugged_in()->rates_hz(), ", ")), ""}};
}

}  // namespace

constexpr camera::CameraKind kSampleCamera = {
    .name = "sample",
    .settings = kSettings,
    .open = open,
    .list = list,
};

}  // namespace facet::sample
