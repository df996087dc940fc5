#include "camera/simulated_devices.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "camera/pixel_buffers.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"

namespace facet::simulated {
namespace {

constexpr int kCells = 64;
constexpr int kRows = 16;
constexpr std::int64_t kTransport_ns = 2'000'000;
/// Exposures that a camera remembers for a slow reader; like the buffers of a driver.
constexpr std::size_t kMostWaiting = 4;
constexpr std::uint8_t kBlack = 0;
constexpr std::uint8_t kWhite = 255;

struct Exposure {
  std::uint64_t sequence = 0;
  std::int64_t time_ns = 0;
  LineMask lit = 0;
  std::size_t period = 0;  ///< of the footage
};

/// What one camera has exposed.
struct Sensor {
  Mutex mutex;
  Condition changed;
  std::deque<Exposure> exposures FACET_GUARDED_BY(mutex);
  std::uint64_t next_sequence FACET_GUARDED_BY(mutex) = 0;
  bool running FACET_GUARDED_BY(mutex) = false;

  bool is_running() {
    const Lock lock(mutex);
    return running;
  }

  void expose(std::int64_t time_ns, LineMask lit, std::size_t period = 0) {
    const Lock lock(mutex);
    if (!running) {
      return;
    }
    if (exposures.size() == kMostWaiting) {
      exposures.pop_front();
    }
    exposures.push_back({next_sequence++, time_ns, lit, period});
    changed.notify_one();
  }
};

/// [top, bottom) of a row of cells.
std::pair<int, int> rows_of(Marker marker, int height_px) {
  const int row = static_cast<int>(marker);
  return {row * height_px / kRows, (row + 1) * height_px / kRows};
}

int column_of(int cell, int width_px) {
  return cell * width_px / kCells;
}

void paint_marker(std::uint8_t* pixels, const SimulatedCameraConfig& config, Marker marker,
                  std::uint64_t bits) {
  const auto [top, bottom] = rows_of(marker, config.height_px);
  const auto stride = static_cast<std::size_t>(config.width_px) * 4;
  std::uint8_t* first = pixels + static_cast<std::size_t>(top) * stride;
  for (int cell = 0; cell < kCells; ++cell) {
    const std::uint8_t value = (bits >> cell & 1) != 0 ? kWhite : kBlack;
    for (int x = column_of(cell, config.width_px); x < column_of(cell + 1, config.width_px); ++x) {
      std::uint8_t* pixel = first + static_cast<std::size_t>(x) * 4;
      std::fill_n(pixel, 3, value);
      pixel[3] = kWhite;
    }
  }
  for (int y = top + 1; y < bottom; ++y) {
    std::memcpy(pixels + static_cast<std::size_t>(y) * stride, first, stride);
  }
}

/// A horizontal ramp that wanders with every picture, the same in all rows.
void paint_ramp(std::uint8_t* pixels, const SimulatedCameraConfig& config, std::uint64_t sequence) {
  const int top = rows_of(Marker::Count, config.height_px).second;
  const auto stride = static_cast<std::size_t>(config.width_px) * 4;
  std::uint8_t* first = pixels + static_cast<std::size_t>(top) * stride;
  for (int x = 0; x < config.width_px; ++x) {
    const auto value = static_cast<std::uint8_t>((static_cast<std::uint64_t>(x) + sequence) & 0xFF);
    std::uint8_t* pixel = first + static_cast<std::size_t>(x) * 4;
    std::fill_n(pixel, 3, value);
    pixel[3] = kWhite;
  }
  for (int y = top + 1; y < config.height_px; ++y) {
    std::memcpy(pixels + static_cast<std::size_t>(y) * stride, first, stride);
  }
}

/// The picture of a camera in the slot of a period that the lines select; null where there is none.
const Footage::Picture* select(const Footage& footage, std::size_t camera, const Exposure& exposure) {
  const auto at = std::find(footage.patterns.begin(), footage.patterns.end(), exposure.lit);
  if (at == footage.patterns.end()) {
    return nullptr;
  }
  const std::size_t period_length = footage.patterns.size();
  const std::size_t period = std::min(exposure.period, footage.slots.size() / period_length - 1);
  const auto in_period = static_cast<std::size_t>(at - footage.patterns.begin());
  return &footage.slots[period * period_length + in_period].at(camera);
}

/// picture: null for black.
void paint(std::uint8_t* pixels, const Footage::Picture* picture, const SimulatedCameraConfig& config) {
  const auto count = static_cast<std::size_t>(config.width_px) * static_cast<std::size_t>(config.height_px);
  const auto channels = static_cast<std::size_t>(picture != nullptr ? picture->channels : 1);
  constexpr std::uint8_t kNothing[] = {kBlack};
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint8_t* from = picture != nullptr ? picture->values.data() + i * channels : kNothing;
    std::uint8_t* to = pixels + 4 * i;
    to[0] = from[0];
    to[1] = from[channels == 3 ? 1 : 0];
    to[2] = from[channels == 3 ? 2 : 0];
    to[3] = kWhite;
  }
}

class SimulatedCamera final : public Camera {
 public:
  SimulatedCamera(SimulatedCameraConfig config, std::shared_ptr<Sensor> sensor, bool triggered,
                  std::shared_ptr<const Footage> footage, std::size_t footage_camera)
      : config_(std::move(config)),
        sensor_(std::move(sensor)),
        triggered_(triggered),
        footage_(std::move(footage)),
        footage_camera_(footage_camera) {}

  CameraInfo info() const override {
    return {.name = config_.name.empty() ? "simulated camera" : "simulated camera " + config_.name,
            .width_px = config_.width_px,
            .height_px = config_.height_px,
            .rate_hz = config_.rate_hz,
            .live = true,
            .frame_count = {},
            .intrinsics = {}};
  }

  CameraStatus status() const override {
    const Lock lock(mutex_);
    return status_;
  }

  void start() override {
    started_ns_ = Clock::now_ns();
    {
      const Lock lock(sensor_->mutex);
      sensor_->running = true;
    }
    const Lock lock(mutex_);
    status_.state = CameraState::Opening;
  }

  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    out = {};
    const std::optional<Exposure> exposure = wait(Clock::now() + timeout);
    if (!exposure) {
      return started_ns_ == 0 ? CaptureOutcome::EndOfStream : CaptureOutcome::Timeout;
    }
    Clock::sleep_until(Clock::at(exposure->time_ns + kTransport_ns));
    const auto bytes =
        static_cast<std::size_t>(config_.width_px) * static_cast<std::size_t>(config_.height_px) * 4;
    auto pixels = pool_->take(bytes);
    paint(pixels.get(), *exposure);
    out.sequence = exposure->sequence;
    out.timestamp_ns = exposure->time_ns;
    out.media_time_ns = exposure->time_ns - started_ns_;
    out.width_px = config_.width_px;
    out.height_px = config_.height_px;
    out.stride_bytes = static_cast<std::size_t>(config_.width_px) * 4;
    out.pixels = std::move(pixels);
    const Lock lock(mutex_);
    status_.state = CameraState::Streaming;
    ++status_.counters.delivered;
    status_.counters.lost += exposure->sequence - next_sequence_;
    next_sequence_ = exposure->sequence + 1;
    return CaptureOutcome::Delivered;
  }

  void stop() override {
    started_ns_ = 0;
    {
      const Lock lock(sensor_->mutex);
      sensor_->running = false;
      sensor_->exposures.clear();
    }
    const Lock lock(mutex_);
    status_.state = CameraState::Idle;
  }

  std::string last_error() const override { return {}; }

 private:
  void paint(std::uint8_t* pixels, const Exposure& exposure) const {
    if (footage_ == nullptr) {
      paint_marker(pixels, config_, Marker::Lines, exposure.lit);
      paint_marker(pixels, config_, Marker::Count, exposure.sequence);
      paint_ramp(pixels, config_, exposure.sequence);
    } else {
      simulated::paint(pixels, select(*footage_, footage_camera_, exposure), config_);
    }
  }

  std::optional<Exposure> wait(Clock::time_point deadline) {
    if (!triggered_ && started_ns_ != 0) {
      const auto due_ns =
          started_ns_ + static_cast<std::int64_t>(static_cast<double>(own_count_) * 1e9 / config_.rate_hz);
      Clock::sleep_until(std::min(deadline, Clock::at(due_ns)));
      if (Clock::at(due_ns) > deadline) {
        return std::nullopt;
      }
      ++own_count_;
      sensor_->expose(due_ns, 0);
    }
    const Lock lock(sensor_->mutex);
    if (!sensor_->changed.wait_until(
            sensor_->mutex, Clock::wake(deadline),
            [&]() FACET_REQUIRES(sensor_->mutex) { return !sensor_->exposures.empty(); })) {
      return std::nullopt;
    }
    const Exposure exposure = sensor_->exposures.front();
    sensor_->exposures.pop_front();
    return exposure;
  }

  SimulatedCameraConfig config_;
  std::shared_ptr<Sensor> sensor_;
  bool triggered_;
  std::shared_ptr<const Footage> footage_;  ///< null: markers
  std::size_t footage_camera_;
  std::int64_t started_ns_ = 0;  ///< 0: stopped
  std::uint64_t own_count_ = 0;
  std::uint64_t next_sequence_ = 0;
  std::shared_ptr<camera::PixelBuffers> pool_ = std::make_shared<camera::PixelBuffers>();
  mutable Mutex mutex_;
  CameraStatus status_ FACET_GUARDED_BY(mutex_);
};

}  // namespace

struct SimulatedDevices::Wires {
  LineMask cameras = 0;
  LineMask projectors = 0;
  std::shared_ptr<const Footage> footage;  ///< null: none
  Mutex mutex;
  std::vector<std::shared_ptr<Sensor>> sensors FACET_GUARDED_BY(mutex);
  LineMask level FACET_GUARDED_BY(mutex) = 0;
  std::optional<std::int64_t> begun_ns FACET_GUARDED_BY(mutex);  ///< when its first period began

  /// The period of the performance at a firing.
  std::size_t period_at(std::int64_t time_ns, LineMask lit) FACET_REQUIRES(mutex) {
    if (footage == nullptr) {
      return 0;
    }
    const double slot_ns = 1e9 / footage->slots_per_second;
    const auto& patterns = footage->patterns;
    const auto in_period = std::find(patterns.begin(), patterns.end(), lit) - patterns.begin();
    if (!begun_ns && in_period == 0 && std::all_of(sensors.begin(), sensors.end(), [](const auto& sensor) {
          return sensor->is_running();
        })) {
      begun_ns = time_ns;
    }
    const double slots = static_cast<double>(time_ns - begun_ns.value_or(time_ns)) / slot_ns;
    return static_cast<std::size_t>(std::llround(slots)) / patterns.size();
  }
};

void Footage::add(const FrameSet& set) {
  std::vector<Picture>& pictures = slots.emplace_back();
  for (const std::string& name : cameras) {
    const auto at = std::find(set.camera_names->begin(), set.camera_names->end(), name);
    const Frame* frame = at == set.camera_names->end()
                             ? nullptr
                             : &set.frames.at(static_cast<std::size_t>(at - set.camera_names->begin()));
    if (frame == nullptr || frame->empty()) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("slot {} of the footage has no picture of camera '{}'", set.slot, name));
    }
    const auto camera = pictures.size();
    if (const Picture& first = slots.front()[camera];
        slots.size() > 1 && (frame->width_px != first.width_px || frame->height_px != first.height_px)) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("slot {} of the footage has a picture of camera '{}' of another size than before",
                      set.slot, name));
    }
    Picture& picture = pictures.emplace_back();
    picture.width_px = frame->width_px;
    picture.height_px = frame->height_px;
    bool grey = true;
    for (int y = 0; y < frame->height_px && grey; ++y) {
      const std::uint8_t* row = frame->row(y);
      for (int x = 0; x < frame->width_px; ++x) {
        grey = grey && row[4 * x] == row[4 * x + 1] && row[4 * x] == row[4 * x + 2];
      }
    }
    picture.channels = grey ? 1 : 3;
    for (int y = 0; y < frame->height_px; ++y) {
      const std::uint8_t* row = frame->row(y);
      for (int x = 0; x < frame->width_px; ++x) {
        picture.values.insert(picture.values.end(), row + 4 * x, row + 4 * x + picture.channels);
      }
    }
  }
}

SimulatedDevices::SimulatedDevices(LineMask camera_lines, LineMask projector_lines,
                                   std::shared_ptr<const Footage> footage)
    : wires_(std::make_shared<Wires>()) {
  wires_->cameras = camera_lines;
  wires_->projectors = projector_lines;
  wires_->footage = std::move(footage);
}

void SimulatedDevices::on_change(LineMask active, std::int64_t time_ns) {
  const Lock lock(wires_->mutex);
  const LineMask cameras = wires_->cameras;
  const bool fires = cameras != 0 && (active & cameras) == cameras && (wires_->level & cameras) != cameras;
  wires_->level = active;
  if (fires) {
    const LineMask lit = active & wires_->projectors;
    const std::size_t period = wires_->period_at(time_ns, lit);
    for (const std::shared_ptr<Sensor>& sensor : wires_->sensors) {
      sensor->expose(time_ns, lit, period);
    }
  }
}

std::unique_ptr<Camera> SimulatedDevices::camera(const SimulatedCameraConfig& config, bool triggered) const {
  auto sensor = std::make_shared<Sensor>();
  const std::shared_ptr<const Footage> footage = wires_->footage;
  SimulatedCameraConfig seen = config;
  std::size_t at = 0;
  if (footage != nullptr) {
    at = static_cast<std::size_t>(std::find(footage->cameras.begin(), footage->cameras.end(), config.name) -
                                  footage->cameras.begin());
    if (at == footage->cameras.size() || footage->slots.size() < footage->patterns.size()) {
      throw Error(ErrorKind::Usage,
                  fmt::format("camera '{}' is not in the footage, or it is shorter than one period of the "
                              "trigger's patterns: its cameras are {}",
                              config.name, fmt::join(footage->cameras, ", ")));
    }
    seen.width_px = footage->slots.front()[at].width_px;
    seen.height_px = footage->slots.front()[at].height_px;
  }
  if (triggered) {
    const Lock lock(wires_->mutex);
    wires_->sensors.push_back(sensor);
  }
  return std::make_unique<SimulatedCamera>(seen, std::move(sensor), triggered, footage, at);
}

std::uint64_t read_marker(const Frame& frame, Marker marker) {
  constexpr int kSure = 64;  // a codec may have touched the pixels
  std::uint64_t bits = 0;
  const auto [top, bottom] = rows_of(marker, frame.height_px);
  const std::uint8_t* row = frame.row((top + bottom) / 2);
  for (int cell = 0; cell < kCells; ++cell) {
    const int x = (column_of(cell, frame.width_px) + column_of(cell + 1, frame.width_px)) / 2;
    const int value = row[static_cast<std::size_t>(x) * 4 + 1];
    if (value > kBlack + kSure && value < kWhite - kSure) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("cell {} of the marker has value {}: not a picture of a simulated camera", cell,
                              value));
    }
    bits |= value > 127 ? std::uint64_t{1} << cell : 0;
  }
  return bits;
}

}  // namespace facet::simulated

namespace facet::camera {
namespace {

constexpr CameraSetting kSettings[] = {kWidthSetting, kHeightSetting, kRateSetting, kTurnSetting,
                                       kMirrorSetting};

std::unique_ptr<Camera> open_alone(const CameraConfig& config) {
  return simulated::SimulatedDevices(0, 0).camera(
      {"", config.live.width_px, config.live.height_px, config.live.rate_hz}, false);
}

}  // namespace

constexpr CameraKind kSimulatedCamera = {
    .name = "simulated",
    .settings = kSettings,
    .open = open_alone,
};

}  // namespace facet::camera
