#include "camera/contained_camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <utility>

#include "camera/device_fault.hpp"
#include "camera/host_process.hpp"
#include "camera/host_protocol.hpp"
#include "camera/live_camera.hpp"
#include "camera/pixel_buffers.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"

namespace facet::camera {
namespace {

/// A host converts times from other clocks; so much they may be off.
constexpr std::int64_t kClockSlack_ns = kSecond_ns / 10;
/// The exposure of the first frame may have begun before the host: a frame period, at 1 Hz.
constexpr std::int64_t kOldest_ns = 2 * kSecond_ns;
/// A jump of the numbers by more is no loss.
constexpr std::uint64_t kMostLost = 1'000'000;
/// A host that is asked to end does so within this, or is ended.
constexpr int kEndPatience_ms = 500;

/// Signs of life that may have piled up unread, beside one in each period.
constexpr std::int64_t kAliveSlack = 20;

/// Throws where a host says what it may not say now.
void check_turn(HostPhase phase, const HostMessage& message) {
  if (!may_say(phase, message.kind)) {
    constexpr std::array kDoing = {"opens its camera", "delivers frames", "lists cameras"};
    throw DeviceFault(DeviceFault::Kind::Failing,
                      fmt::format("its process says {} while it {}", to_string(message.kind),
                                  kDoing.at(static_cast<std::size_t>(phase))));
  }
}

/// The next message, awaited until `until_ns`; nothing where none comes.
std::optional<HostMessage> await_message(HostProcess& process, std::int64_t until_ns) {
  for (;;) {
    if (std::optional<HostMessage> message = process.receive()) {
      return message;
    }
    if (Clock::now_ns() >= until_ns) {
      return std::nullopt;
    }
    process.wait(until_ns);
  }
}

class ContainedCamera final : public LiveCamera {
 public:
  ContainedCamera(const CameraConfig& config, std::filesystem::path program, const HostPatience& patience);

  void expect_frames(bool due) override;

 private:
  void check_device();
  std::filesystem::path program() const { return program_.empty() ? host_program() : program_; }
  bool is_open() const override { return process_ != nullptr; }
  void open() override;
  void close(CameraState why) override;
  bool take(Frame& out) override;
  void wait(std::int64_t until_ns) override;
  std::string silence(double silent_s) const override;
  void note_sign_of_life();
  void note_counters(const CameraCounters& counters);
  void deliver(const HostMessage& message, Frame& out);
  void check_order(const HostMessage& message, std::int64_t now_ns) const;
  void wind_watchdog();

  CameraConfig config_;
  std::filesystem::path program_;
  HostPatience patience_;
  PictureLayout layout_;

  // The capturing thread's.
  std::unique_ptr<HostProcess> process_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  bool opened_ = false;                         ///< the process says that its camera is
  bool asked_ = false;                          ///< it was asked for a frame
  std::int64_t signs_of_life_ = 0;              ///< that this process has sent
  std::optional<std::uint64_t> host_sequence_;  ///< of the newest frame of this process
  std::uint64_t sequence_ = 0;                  ///< of the newest frame
  std::uint64_t sequence_offset_ = 0;           ///< from the process's numbers to ours
  CameraCounters before_;                       ///< of the processes that are gone
  CameraCounters process_counters_;
};

ContainedCamera::ContainedCamera(const CameraConfig& config, std::filesystem::path program,
                                 const HostPatience& patience)
    : LiveCamera({patience.shortest_pause, patience.longest_pause, patience.absent_pause, patience.proven}),
      config_(config),
      program_(std::move(program)),
      patience_(patience),
      layout_(picture_layout(config.live.width_px, config.live.height_px)) {
  info_.name = fmt::format("{} {}", config.kind,
                           config.libcamera.id.empty() ? std::string("camera") : config.libcamera.id);
  info_.width_px = config.live.width_px;
  info_.height_px = config.live.height_px;
  info_.rate_hz = config.live.rate_hz;
  info_.live = true;
  try {
    check_device();
  } catch (const DeviceFault& fault) {
    note_fault(fault);
  }
}

/// Opens the camera in a process that ends at once; throws what it says.
void ContainedCamera::check_device() {
  std::vector<std::string> arguments = host_arguments(config_);
  arguments.emplace_back("--check");
  HostProcess process(program(), arguments, 0);
  const auto message = await_message(process, Clock::now_ns() + in_ns(patience_.open));
  if (!message) {
    throw DeviceFault(DeviceFault::Kind::Failing, fmt::format("is not open after {:.3g} s: its process hangs",
                                                              in_s(in_ns(patience_.open))));
  }
  check_turn(HostPhase::Opening, *message);
  if (message->kind == HostMessage::Kind::Fault) {
    throw DeviceFault(message->fault, message->text);
  }
  if (!message->name.empty()) {
    info_.name = message->name;
  }
  process.end_gently(kEndPatience_ms);
}

/// While no frames are due, that the process says that it is alive is enough.
void ContainedCamera::expect_frames(bool due) {
  if (std::exchange(frames_due_, due) != due && opened_) {
    wind_watchdog();
  }
}

void ContainedCamera::wind_watchdog() {
  const bool soon = frames_due_ && host_sequence_;
  watchdog_ns_ = Clock::now_ns() + in_ns(soon ? config_.live.stall_after
                                              : std::max(config_.live.stall_after, patience_.first_frame));
}

std::string ContainedCamera::silence(double silent_s) const {
  const char* what = !opened_ ? "is not open after {:.3g} s: its process hung and was ended"
                     : host_sequence_
                         ? "no frame for {:.3g} s: its process was ended"
                         : "is open and has delivered nothing for {:.3g} s: its process was ended";
  return fmt::format(fmt::runtime(what), silent_s);
}

/// Ends the process, gently where it has done nothing wrong.
void ContainedCamera::close(CameraState why) {
  if (why == CameraState::Idle && process_ != nullptr) {
    process_->end_gently(kEndPatience_ms);
  }
  process_.reset();
  for (const CameraCount& count : kCameraCounts) {
    before_.*count.value += process_counters_.*count.value;
  }
  process_counters_ = {};
}

void ContainedCamera::open() {
  opened_ = false;
  asked_ = false;
  signs_of_life_ = 0;
  host_sequence_.reset();
  process_ = std::make_unique<HostProcess>(program(), host_arguments(config_), layout_.total_bytes);
  watchdog_ns_ = begun_ns_ + in_ns(patience_.open);
}

void ContainedCamera::wait(std::int64_t until_ns) {
  if (process_ != nullptr) {
    process_->wait(until_ns);
  } else {
    Clock::sleep_until(Clock::at(until_ns));
  }
}

/// Reads what the process has said; whether a frame was among it.
bool ContainedCamera::take(Frame& out) {
  if (!asked_) {
    process_->request_frame();
    asked_ = true;
  }
  while (const std::optional<HostMessage> message = process_->receive()) {
    check_turn(opened_ ? HostPhase::Delivering : HostPhase::Opening, *message);
    switch (message->kind) {
      case HostMessage::Kind::Opened:
        opened_ = true;
        last_life_ns_ = Clock::now_ns();
        wind_watchdog();
        break;
      case HostMessage::Kind::Alive:
        note_sign_of_life();
        note_counters(message->counters);
        if (opened_ && !frames_due_) {
          wind_watchdog();
        }
        break;
      case HostMessage::Kind::Frame:
        note_counters(message->counters);
        deliver(*message, out);
        return true;
      case HostMessage::Kind::Fault:
        throw DeviceFault(message->fault, message->text);
      case HostMessage::Kind::Listed:
        break;  // check_turn threw
    }
  }
  return false;
}

/// So a host can't keep `take` reading: every kind of message comes once, is asked for, or is counted here.
void ContainedCamera::note_sign_of_life() {
  const std::int64_t due = (Clock::now_ns() - begun_ns_) / in_ns(kAlivePeriod);
  if (++signs_of_life_ > due + kAliveSlack) {
    throw DeviceFault(DeviceFault::Kind::Failing,
                      fmt::format("its process said {} times in {:.3g} s that it is alive", signs_of_life_,
                                  in_s(Clock::now_ns() - begun_ns_)));
  }
}

/// What the process has counted; what was delivered is counted here.
void ContainedCamera::note_counters(const CameraCounters& counters) {
  for (const CameraCount& count : kCameraCounts) {
    if (counters.*count.value < process_counters_.*count.value) {
      throw DeviceFault(DeviceFault::Kind::Failing,
                        fmt::format("its process counts '{}' backwards", count.name));
    }
  }
  process_counters_ = counters;
  process_counters_.delivered = 0;
  process_counters_.reopened = 0;
  const Lock lock(shown_mutex_);
  for (const CameraCount& count : kCameraCounts) {
    if (count.value != &CameraCounters::delivered && count.value != &CameraCounters::reopened) {
      status_.counters.*count.value = before_.*count.value + process_counters_.*count.value;
    }
  }
}

void ContainedCamera::check_order(const HostMessage& message, std::int64_t now_ns) const {
  if (!asked_) {
    throw DeviceFault(DeviceFault::Kind::Failing, "its process sent a frame that nobody had asked for");
  }
  const std::uint64_t least = host_sequence_ ? *host_sequence_ + 1 : 0;
  if (message.sequence < least || message.sequence - least > kMostLost) {
    throw DeviceFault(
        DeviceFault::Kind::Failing,
        fmt::format("its process sent frame {} where frame {} is next", message.sequence, least));
  }
  if (message.timestamp_ns < begun_ns_ - kOldest_ns || message.timestamp_ns > now_ns + kClockSlack_ns) {
    throw DeviceFault(DeviceFault::Kind::Failing,
                      fmt::format("its process sent a frame of a time that is {:.3g} s from now",
                                  in_s(message.timestamp_ns - now_ns)));
  }
}

void ContainedCamera::deliver(const HostMessage& message, Frame& out) {
  const std::int64_t now_ns = Clock::now_ns();
  check_order(message, now_ns);
  asked_ = false;
  const std::uint64_t mark = message.sequence + 1;
  const std::uint8_t* picture = process_->picture();
  const auto mark_at = [picture](std::size_t offset) {
    return __atomic_load_n(reinterpret_cast<const std::uint64_t*>(picture + offset), __ATOMIC_SEQ_CST);
  };
  const std::size_t pixel_bytes = layout_.end_mark_at - layout_.pixels_at;
  auto pixels = pool_->take(pixel_bytes);
  const bool whole = mark_at(layout_.end_mark_at) == mark;
  std::memcpy(pixels.get(), picture + layout_.pixels_at, pixel_bytes);
  if (!whole || mark_at(0) != mark) {
    throw DeviceFault(
        DeviceFault::Kind::Failing,
        fmt::format("its process changed the pixels of frame {} while they were read", message.sequence));
  }

  if (!host_sequence_) {
    // What was between two processes is at least one frame.
    sequence_offset_ = delivered_before_ ? sequence_ + 2 : 0;
  }
  Frame frame;
  frame.sequence = message.sequence + sequence_offset_;
  date(frame, std::min(message.timestamp_ns, now_ns));
  frame.width_px = info_.width_px;
  frame.height_px = info_.height_px;
  frame.stride_bytes = layout_.stride_bytes;
  frame.corrupt = message.corrupt;
  frame.pixels = std::move(pixels);
  sequence_ = frame.sequence;
  note_delivery(frame);
  watchdog_ns_ = last_life_ns_ + in_ns(config_.live.stall_after);
  host_sequence_ = message.sequence;
  out = std::move(frame);
}

}  // namespace

std::unique_ptr<Camera> open_contained_camera(const CameraConfig& config,
                                              const std::filesystem::path& program,
                                              const HostPatience& patience) {
  return std::make_unique<ContainedCamera>(config, program, patience);
}

std::vector<CameraListing> list_contained_cameras(const std::filesystem::path& program,
                                                  std::chrono::milliseconds patience) {
  constexpr std::size_t kMost = 256;
  std::vector<CameraListing> found;
  try {
    HostProcess process(program.empty() ? host_program() : program, {"--list"}, 0);
    const std::int64_t until_ns = Clock::now_ns() + in_ns(patience);
    for (;;) {
      const auto message = await_message(process, until_ns);
      if (!message) {
        throw DeviceFault(DeviceFault::Kind::Failing,
                          fmt::format("its process does not answer within {:.3g} s", in_s(in_ns(patience))));
      }
      check_turn(HostPhase::Listing, *message);
      if (message->kind == HostMessage::Kind::Fault) {
        throw DeviceFault(message->fault, message->text);
      }
      if (message->kind == HostMessage::Kind::Alive) {
        return found;
      }
      if (found.size() == kMost) {
        throw DeviceFault(DeviceFault::Kind::Failing,
                          fmt::format("its process lists more than {} cameras", kMost));
      }
      found.push_back({message->name, message->text});
    }
  } catch (const DeviceFault& fault) {
    throw Error(ErrorKind::Unavailable,
                fmt::format("the cameras of libcamera can't be listed: {}", fault.what()));
  }
}

namespace {

constexpr CameraSetting kSettings[] = {
    {"id", &at<&CameraConfig::libcamera, &LibcameraConfig::id>},
    {"format", &at<&CameraConfig::live, &LiveConfig::format>, 0, 0, 1, kLibcameraFormats},
    {"gain", &at<&CameraConfig::libcamera, &LibcameraConfig::gain>, 0.01, 1000},
    {"red_gain", &at<&CameraConfig::libcamera, &LibcameraConfig::red_gain>, 0.01, 100},
    {"blue_gain", &at<&CameraConfig::libcamera, &LibcameraConfig::blue_gain>, 0.01, 100},
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
  for (const CameraListing& camera : list_contained_cameras()) {
    found.push_back({fmt::format("libcamera, id = '{}': {}", camera.id, camera.description), ""});
  }
  return found;
}

}  // namespace

constexpr CameraKind kLibcamera = {
    .name = "libcamera",
    .settings = kSettings,
    .pair = {{"red_gain", "blue_gain"}},
    .open = [](const CameraConfig& config) { return open_contained_camera(config); },
    .list = list_for_people,
};

}  // namespace facet::camera
