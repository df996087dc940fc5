#pragma once

#include <semaphore.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "facet/clock.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

/// Events on their way from the edge thread to one reader. put never waits: where the ring is full the event
/// is lost and counted.
class EventRing final : public TriggerEventSink {
 public:
  explicit EventRing(std::size_t capacity) : slots_(capacity) { ::sem_init(&filled_, 0, 0); }
  ~EventRing() override { ::sem_destroy(&filled_); }

  /// One writing thread; real-time safe.
  void put(const TriggerEvent& event) override {
    const std::uint64_t written = written_.load(std::memory_order_relaxed);
    if (written - taken_.load(std::memory_order_acquire) == slots_.size()) {
      lost_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    slots_[written % slots_.size()] = event;
    written_.store(written + 1, std::memory_order_release);
    ::sem_post(&filled_);
  }

  /// One reading thread. False where nothing came within the time.
  bool take(TriggerEvent& out, std::chrono::nanoseconds timeout) {
    // A POSIX semaphore: the timed wait of libstdc++ 12's std::counting_semaphore can sleep for ever.
    const auto deadline = Clock::wake(Clock::now() + timeout).time_since_epoch();
    const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(deadline);
    const timespec until = {seconds.count(), std::chrono::nanoseconds(deadline - seconds).count()};
    const std::uint64_t taken = taken_.load(std::memory_order_relaxed);
    while (written_.load(std::memory_order_acquire) == taken) {
      if (::sem_clockwait(&filled_, CLOCK_MONOTONIC, &until) != 0 && errno != EINTR) {
        return false;
      }
    }
    out = slots_[taken % slots_.size()];
    taken_.store(taken + 1, std::memory_order_release);
    return true;
  }

  std::uint64_t lost() const { return lost_.load(std::memory_order_relaxed); }

 private:
  std::vector<TriggerEvent> slots_;
  std::atomic<std::uint64_t> written_ = 0;
  std::atomic<std::uint64_t> taken_ = 0;
  std::atomic<std::uint64_t> lost_ = 0;
  sem_t filled_{};  ///< posted for every event; posts of events that were taken without waiting stay
};

}  // namespace facet::trigger
