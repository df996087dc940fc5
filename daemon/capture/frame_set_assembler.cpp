#include "capture/frame_set_assembler.hpp"

#include <algorithm>
#include <utility>

#include "facet/clock.hpp"
#include "facet/mutex.hpp"

namespace facet::capture {

void FrameSetAssembler::fired(std::uint64_t slot, std::int64_t fired_ns) {
  const Lock lock(mutex_);
  matcher_.fired(slot, fired_ns);
  changed_.notify_one();
}

void FrameSetAssembler::push(std::size_t camera, Frame frame) {
  const Lock lock(mutex_);
  matcher_.push(camera, std::move(frame), Clock::now_ns());
  changed_.notify_one();
}

void FrameSetAssembler::set_streaming(std::size_t camera, bool streaming) {
  const Lock lock(mutex_);
  matcher_.set_streaming(camera, streaming);
  changed_.notify_one();
}

FrameSetAssembler::Outcome FrameSetAssembler::next(FrameSet& out, std::chrono::milliseconds timeout) {
  std::fill(out.frames.begin(), out.frames.end(), Frame{});
  const auto give_up = Clock::now() + timeout;
  const Lock lock(mutex_);
  while (!closed_) {
    const std::int64_t now_ns = Clock::now_ns();
    matcher_.advance(now_ns);
    if (matcher_.take(out, now_ns)) {
      return Outcome::Delivered;
    }
    if (Clock::at(now_ns) >= give_up) {
      return Outcome::Timeout;
    }
    auto wake = give_up;
    if (const auto deadline_ns = matcher_.next_deadline_ns()) {
      wake = std::min(wake, Clock::at(*deadline_ns));
    }
    changed_.wait_until(mutex_, Clock::wake(wake));
  }
  return Outcome::Closed;
}

void FrameSetAssembler::close() {
  const Lock lock(mutex_);
  closed_ = true;
  changed_.notify_all();
}

CaptureStatistics FrameSetAssembler::statistics() const {
  const Lock lock(mutex_);
  return matcher_.statistics();
}

}  // namespace facet::capture
