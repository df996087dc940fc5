#include "camera/live_camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <exception>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"

namespace facet::camera {
namespace {

CameraState state_of(const DeviceFault& fault) {
  return fault.kind == DeviceFault::Kind::Absent ? CameraState::Absent : CameraState::Failing;
}

}  // namespace

std::int64_t LiveCamera::now_ns() const {
  return Clock::now_ns();
}

std::string LiveCamera::silence(double silent_s) const {
  return fmt::format("no frame for {:.3g} s", silent_s);
}

CameraStatus LiveCamera::status() const {
  const Lock lock(shown_mutex_);
  return status_;
}

std::string LiveCamera::last_error() const {
  const Lock lock(shown_mutex_);
  return last_error_;
}

void LiveCamera::set_state(CameraState state, const std::string& reason) {
  const Lock lock(shown_mutex_);
  status_.state = state;
  status_.reason = reason;
  if (!reason.empty()) {
    last_error_ = reason;
  }
}

void LiveCamera::count(std::uint64_t CameraCounters::*which, std::uint64_t how_many) {
  const Lock lock(shown_mutex_);
  status_.counters.*which += how_many;
}

void LiveCamera::note_fault(const DeviceFault& fault) {
  if (fault.kind == DeviceFault::Kind::Unsuitable) {
    throw Error(ErrorKind::Usage, named(fault.what()));
  }
  set_state(state_of(fault), named(fault.what()));
}

void LiveCamera::start() {
  if (!started_) {
    started_ = true;
    retry_ns_ = now_ns();
  }
}

void LiveCamera::restart(const std::string& why) {
  if (is_open()) {
    give_up(CameraState::Failing, why);
  }
}

void LiveCamera::stop() {
  stopped_ = true;
  close(CameraState::Idle);
  set_state(CameraState::Idle, "");
}

CaptureOutcome LiveCamera::next(Frame& out, std::chrono::milliseconds timeout) {
  if (!started_ || stopped_) {
    return CaptureOutcome::EndOfStream;
  }
  const std::int64_t deadline_ns = now_ns() + in_ns(timeout);
  try {
    while (is_open() || reopen(deadline_ns)) {
      if (take(out)) {
        return CaptureOutcome::Delivered;
      }
      const std::int64_t now = now_ns();
      if (now >= watchdog_ns_) {
        give_up(CameraState::Stalled, silence(in_s(now - last_life_ns_)));
        break;
      }
      if (now >= deadline_ns) {
        break;
      }
      wait(std::min(deadline_ns, watchdog_ns_));
    }
  } catch (const DeviceFault& fault) {
    give_up(state_of(fault), fault.what());
  } catch (const std::exception& fault) {
    give_up(CameraState::Failing, fault.what());
  }
  return CaptureOutcome::Timeout;
}

void LiveCamera::give_up(CameraState state, const std::string& what) {
  close(state);
  const std::int64_t now = now_ns();
  if (!first_of_stream_ && now - begun_ns_ >= in_ns(pauses_.proven)) {
    pause_ns_ = in_ns(pauses_.shortest);
  }
  if (state == CameraState::Absent) {
    retry_ns_ = now + in_ns(pauses_.absent);
  } else {
    retry_ns_ = now + pause_ns_;
    pause_ns_ = std::min(2 * pause_ns_, in_ns(pauses_.longest));
  }
  set_state(state, named(what));
}

/// Opens the device when its time has come; false where that is after the deadline.
bool LiveCamera::reopen(std::int64_t deadline_ns) {
  if (now_ns() < retry_ns_) {
    wait(std::min(retry_ns_, deadline_ns));
    if (deadline_ns < retry_ns_) {
      return false;
    }
  }
  first_of_stream_ = true;
  begun_ns_ = last_life_ns_ = now_ns();
  open();
  // A device that stalled or failed shows with its first frame whether it is well again.
  if (const CameraState state = status().state; state == CameraState::Idle || state == CameraState::Absent) {
    set_state(CameraState::Opening, "");
  }
  return true;
}

void LiveCamera::date(Frame& frame, std::int64_t exposed_ns) {
  frame.timestamp_ns = exposed_ns;
  if (delivered_before_) {
    frame.timestamp_ns = std::max(exposed_ns, timestamp_ns_ + 1);
  } else {
    first_timestamp_ns_ = exposed_ns;
  }
  frame.media_time_ns = frame.timestamp_ns - first_timestamp_ns_;
}

void LiveCamera::note_delivery(const Frame& frame) {
  timestamp_ns_ = frame.timestamp_ns;
  last_life_ns_ = now_ns();
  const Lock lock(shown_mutex_);
  ++status_.counters.delivered;
  status_.counters.reopened += delivered_before_ && first_of_stream_ ? 1 : 0;
  delivered_before_ = true;
  first_of_stream_ = false;
  status_.state = CameraState::Streaming;
  status_.reason.clear();
}

}  // namespace facet::camera
