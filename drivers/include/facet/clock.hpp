#pragma once

#include <time.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>

namespace facet {

/// What may stand in the kernel's place for this process: a test's clock, a simulation's. Any thread asks it,
/// real-time ones too, so it neither throws nor waits; now() never goes back.
class TimeSource {
 public:
  TimeSource() = default;
  TimeSource(const TimeSource&) = delete;
  TimeSource& operator=(const TimeSource&) = delete;
  virtual ~TimeSource() = default;

  virtual std::chrono::steady_clock::time_point now() const noexcept = 0;
  virtual std::chrono::system_clock::time_point utc() const noexcept = 0;
};

/// The one clock of daemon, drivers and tools (tests/style/check-seams lets them read no other). now() is
/// CLOCK_MONOTONIC, which frames and trigger events are stamped by; utc() is for names and headers alone: it
/// jumps when it is set.
///
/// Any thread; real-time safe: without an InstalledClock a read is one load and one branch more than the
/// kernel's (no system call on x86). Time points are std::chrono's, so that whatever waits can take them, but
/// waiting is the kernel's: a time until which to wait (wait_until of condition variables, sem_clockwait)
/// goes through wake(). Waits for a duration (wait_for, sleep_for, poll and its like, epoll, sockets'
/// timeouts, SQLite's busy timeout) last that long by the kernel's clock whatever is installed. The camera
/// host is a process of its own and always has the kernel's clock.
class Clock {
 public:
  using duration = std::chrono::steady_clock::duration;
  using rep = duration::rep;
  using period = duration::period;
  using time_point = std::chrono::steady_clock::time_point;
  static constexpr bool is_steady = true;

  static time_point now() noexcept {
    const TimeSource* const source = installed_.load(std::memory_order_acquire);
    return source == nullptr ? std::chrono::steady_clock::now() : source->now();
  }

  /// now() in nanoseconds, as in Frame::timestamp_ns.
  static std::int64_t now_ns() noexcept { return now().time_since_epoch().count(); }

  /// The time whose now_ns() it is.
  static constexpr time_point at(std::int64_t time_ns) noexcept {
    return time_point(std::chrono::nanoseconds(time_ns));
  }

  static std::chrono::system_clock::time_point utc() noexcept {
    const TimeSource* const source = installed_.load(std::memory_order_acquire);
    return source == nullptr ? std::chrono::system_clock::now() : source->utc();
  }

  /// CLOCK_BOOTTIME: now_ns() and the time asleep. Some camera drivers stamp by it; no other use.
  static std::int64_t boot_ns() noexcept {
    timespec time{};
    if (installed_.load(std::memory_order_acquire) != nullptr ||
        ::clock_gettime(CLOCK_BOOTTIME, &time) != 0) {
      return now_ns();
    }
    return time.tv_sec * std::int64_t{1'000'000'000} + time.tv_nsec;
  }

  /// When the kernel's clock will show what this one shows at `time`: in an hour at most, so who waits looks
  /// again.
  static time_point wake(time_point time) noexcept {
    const TimeSource* const source = installed_.load(std::memory_order_acquire);
    return source == nullptr ? time
                             : std::chrono::steady_clock::now() +
                                   std::min<duration>(time - source->now(), std::chrono::hours(1));
  }

  /// Returns at `time` or later, seen from the kernel's clock; real-time safe.
  static void sleep_until(time_point time) noexcept {
    const std::int64_t time_ns = wake(time).time_since_epoch().count();
    const timespec until{time_ns / 1'000'000'000, time_ns % 1'000'000'000};
    while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
    }
  }

 private:
  friend class InstalledClock;
  /// Null: the kernel's. Acquired with every read, so that a source is seen as whole as who installed it left
  /// it.
  static inline std::atomic<const TimeSource*> installed_ = nullptr;
};

/// Puts `source` in the kernel's place for the whole process until it is destroyed; what was there before
/// comes back then. Install before the threads start that shall see it and remove it after they have ended: a
/// thread may be within the source, and time points of two sources are not to be compared. Nested ones end in
/// the other order.
class InstalledClock {
 public:
  explicit InstalledClock(const TimeSource& source)
      : before_(Clock::installed_.exchange(&source, std::memory_order_acq_rel)) {}
  InstalledClock(const InstalledClock&) = delete;
  InstalledClock& operator=(const InstalledClock&) = delete;
  ~InstalledClock() { Clock::installed_.store(before_, std::memory_order_release); }

 private:
  const TimeSource* before_;
};

inline float ms_since(Clock::time_point start) noexcept {
  return std::chrono::duration<float, std::milli>(Clock::now() - start).count();
}

}  // namespace facet
