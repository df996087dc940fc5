#include "camera/contained_camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <exception>
#include <mutex>
#include <optional>
#include <utility>

#include "camera/device_fault.hpp"
#include "camera/host_process.hpp"
#include "camera/host_protocol.hpp"
#include "camera/pixel_buffers.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
/// A host converts times from other clocks; so much they may be off.
constexpr std::int64_t kClockSlack_ns = kSecond_ns / 10;
/// The exposure of the first frame may have begun before the host: a frame period, at 1 Hz.
constexpr std::int64_t kOldest_ns = 2 * kSecond_ns;
/// A jump of the numbers by more is no loss.
constexpr std::uint64_t kMostLost = 1'000'000;
/// A host that is asked to end does so within this, or is ended.
constexpr int kEndPatience_ms = 500;

std::int64_t in_ns(std::chrono::milliseconds time) {
  return std::chrono::nanoseconds(time).count();
}

double in_s(std::int64_t time_ns) {
  return static_cast<double>(time_ns) / static_cast<double>(kSecond_ns);
}

CameraState state_of(DeviceFault::Kind kind) {
  return kind == DeviceFault::Kind::Absent ? CameraState::Absent : CameraState::Failing;
}

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

class ContainedCamera final : public Camera {
 public:
  ContainedCamera(const CameraConfig& config, std::filesystem::path program, const HostPatience& patience);

  CameraInfo info() const override { return info_; }
  CameraStatus status() const override;
  void start() override;
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override;
  void restart(const std::string& why) override;
  void expect_frames(bool due) override;
  void stop() override;
  std::string last_error() const override;

 private:
  void check_device();
  std::filesystem::path program() const { return program_.empty() ? host_program() : program_; }
  bool reopen(std::int64_t deadline_ns);
  bool take(Frame& out);
  void note_sign_of_life();
  void note_counters(const CameraCounters& counters);
  void deliver(const HostMessage& message, Frame& out);
  void check_order(const HostMessage& message, std::int64_t now_ns) const;
  void note_delivery(const Frame& frame, std::int64_t now_ns);
  void wind_watchdog();
  void give_up_stalled(std::int64_t now_ns);
  void give_up(CameraState state, const std::string& reason);
  void set_state(CameraState state, const std::string& reason);

  CameraConfig config_;
  std::filesystem::path program_;
  HostPatience patience_;
  PictureLayout layout_;
  CameraInfo info_;

  // The capturing thread's.
  bool started_ = false;
  bool stopped_ = false;
  std::unique_ptr<HostProcess> process_;
  std::shared_ptr<PixelBuffers> pool_ = std::make_shared<PixelBuffers>();
  std::int64_t retry_ns_ = 0;  ///< while there is no process: when one is started
  std::int64_t pause_ns_;
  std::int64_t begun_ns_ = 0;      ///< when the process was started
  std::int64_t last_life_ns_ = 0;  ///< the last delivery, or when the camera was opened
  bool frames_due_ = true;
  std::int64_t watchdog_ns_ = 0;                ///< the process is given up when no frame has come until then
  bool opened_ = false;                         ///< the process says that its camera is
  bool asked_ = false;                          ///< it was asked for a frame
  std::int64_t signs_of_life_ = 0;              ///< that this process has sent
  std::optional<std::uint64_t> host_sequence_;  ///< of the newest frame of this process
  std::uint64_t sequence_ = 0;                  ///< of the newest frame
  std::uint64_t sequence_offset_ = 0;           ///< from the process's numbers to ours
  std::int64_t timestamp_ns_ = 0;               ///< of the newest frame
  std::int64_t first_timestamp_ns_ = 0;
  bool delivered_before_ = false;  ///< anything, by this process or one before
  CameraCounters before_;          ///< of the processes that are gone
  CameraCounters process_counters_;

  mutable std::mutex shown_mutex_;
  CameraStatus status_;     // guarded by shown_mutex_
  std::string last_error_;  // guarded by shown_mutex_
};

ContainedCamera::ContainedCamera(const CameraConfig& config, std::filesystem::path program,
                                 const HostPatience& patience)
    : config_(config),
      program_(std::move(program)),
      patience_(patience),
      layout_(picture_layout(config.live.width_px, config.live.height_px)),
      pause_ns_(in_ns(patience.shortest_pause)) {
  info_.name = fmt::format("{} {}", config.kind,
                           config.libcamera.id.empty() ? std::string("camera") : config.libcamera.id);
  info_.width_px = config.live.width_px;
  info_.height_px = config.live.height_px;
  info_.rate_hz = config.live.rate_hz;
  info_.live = true;
  try {
    check_device();
  } catch (const DeviceFault& fault) {
    const std::string reason = fmt::format("{}: {}", info_.name, fault.what());
    if (fault.kind == DeviceFault::Kind::Unsuitable) {
      throw Error(ErrorKind::Usage, reason);
    }
    set_state(state_of(fault.kind), reason);
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

void ContainedCamera::start() {
  if (!started_) {
    started_ = true;
    retry_ns_ = Clock::now_ns();
  }
}

void ContainedCamera::restart(const std::string& why) {
  if (process_ != nullptr) {
    give_up(CameraState::Failing, why);
  }
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

void ContainedCamera::stop() {
  stopped_ = true;
  if (process_ != nullptr) {
    process_->end_gently(kEndPatience_ms);
    process_.reset();
  }
  set_state(CameraState::Idle, "");
}

CameraStatus ContainedCamera::status() const {
  const std::scoped_lock lock(shown_mutex_);
  return status_;
}

std::string ContainedCamera::last_error() const {
  const std::scoped_lock lock(shown_mutex_);
  return last_error_;
}

void ContainedCamera::set_state(CameraState state, const std::string& reason) {
  const std::scoped_lock lock(shown_mutex_);
  status_.state = state;
  status_.reason = reason;
  if (!reason.empty()) {
    last_error_ = reason;
  }
}

CaptureOutcome ContainedCamera::next(Frame& out, std::chrono::milliseconds timeout) {
  if (!started_ || stopped_) {
    return CaptureOutcome::EndOfStream;
  }
  const std::int64_t deadline_ns = Clock::now_ns() + in_ns(timeout);
  try {
    while (process_ != nullptr || reopen(deadline_ns)) {
      if (take(out)) {
        return CaptureOutcome::Delivered;
      }
      const std::int64_t now_ns = Clock::now_ns();
      if (now_ns >= watchdog_ns_) {
        give_up_stalled(now_ns);
        break;
      }
      if (now_ns >= deadline_ns) {
        break;
      }
      process_->wait(std::min(deadline_ns, watchdog_ns_));
    }
  } catch (const DeviceFault& fault) {
    give_up(state_of(fault.kind), fault.what());
  } catch (const std::exception& fault) {
    give_up(CameraState::Failing, fault.what());
  }
  return CaptureOutcome::Timeout;
}

void ContainedCamera::give_up_stalled(std::int64_t now_ns) {
  const double silent_s = in_s(now_ns - last_life_ns_);
  const char* what = !opened_ ? "is not open after {:.3g} s: its process hung and was ended"
                     : host_sequence_
                         ? "no frame for {:.3g} s: its process was ended"
                         : "is open and has delivered nothing for {:.3g} s: its process was ended";
  give_up(CameraState::Stalled, fmt::format(fmt::runtime(what), silent_s));
}

/// Ends the process; another one is started after a pause.
void ContainedCamera::give_up(CameraState state, const std::string& reason) {
  process_.reset();
  for (const CameraCount& count : kCameraCounts) {
    before_.*count.value += process_counters_.*count.value;
  }
  process_counters_ = {};
  const std::int64_t now_ns = Clock::now_ns();
  if (host_sequence_ && now_ns - begun_ns_ >= in_ns(patience_.proven)) {
    pause_ns_ = in_ns(patience_.shortest_pause);
  }
  if (state == CameraState::Absent) {
    retry_ns_ = now_ns + in_ns(patience_.absent_pause);
  } else {
    retry_ns_ = now_ns + pause_ns_;
    pause_ns_ = std::min(2 * pause_ns_, in_ns(patience_.longest_pause));
  }
  set_state(state, fmt::format("{}: {}", info_.name, reason));
}

/// Starts a process when its time has come; false where that is after the deadline.
bool ContainedCamera::reopen(std::int64_t deadline_ns) {
  if (Clock::now_ns() < retry_ns_) {
    Clock::sleep_until(Clock::at(std::min(retry_ns_, deadline_ns)));
    if (deadline_ns < retry_ns_) {
      return false;
    }
  }
  opened_ = false;
  asked_ = false;
  signs_of_life_ = 0;
  host_sequence_.reset();
  begun_ns_ = last_life_ns_ = Clock::now_ns();
  process_ = std::make_unique<HostProcess>(program(), host_arguments(config_), layout_.total_bytes);
  watchdog_ns_ = begun_ns_ + in_ns(patience_.open);
  // A device that stalled or failed shows with its first frame whether it is well again.
  if (const CameraState state = status().state; state == CameraState::Idle || state == CameraState::Absent) {
    set_state(CameraState::Opening, "");
  }
  return true;
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
  const std::scoped_lock lock(shown_mutex_);
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
  frame.timestamp_ns = std::min(message.timestamp_ns, now_ns);
  if (delivered_before_) {
    frame.timestamp_ns = std::max(frame.timestamp_ns, timestamp_ns_ + 1);
  } else {
    first_timestamp_ns_ = frame.timestamp_ns;
  }
  frame.media_time_ns = frame.timestamp_ns - first_timestamp_ns_;
  frame.width_px = info_.width_px;
  frame.height_px = info_.height_px;
  frame.stride_bytes = layout_.stride_bytes;
  frame.corrupt = message.corrupt;
  frame.pixels = std::move(pixels);
  note_delivery(frame, now_ns);
  host_sequence_ = message.sequence;
  out = std::move(frame);
}

void ContainedCamera::note_delivery(const Frame& frame, std::int64_t now_ns) {
  sequence_ = frame.sequence;
  timestamp_ns_ = frame.timestamp_ns;
  last_life_ns_ = now_ns;
  watchdog_ns_ = now_ns + in_ns(config_.live.stall_after);
  const std::scoped_lock lock(shown_mutex_);
  ++status_.counters.delivered;
  status_.counters.reopened += delivered_before_ && !host_sequence_ ? 1 : 0;
  delivered_before_ = true;
  status_.state = CameraState::Streaming;
  status_.reason.clear();
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

}  // namespace facet::camera
