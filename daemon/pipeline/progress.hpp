#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>

namespace facet::pipeline {

/// The threads of a pipeline that must get on for it to be alive.
enum class Worker { Capture, Track, Refine };

/// When each worker was last seen to get on, for whoever must notice that one hangs. A worker says so with
/// every piece of work and while it waits for another one (BoundedQueue wakes it for that), so that silence
/// means one thing: it is stuck inside a piece of work, or is not run at all.
class Progress {
 public:
  struct Silence {
    Worker worker = Worker::Capture;
    std::chrono::nanoseconds length{0};
  };

  /// It begins, or gets on. The worker's own thread, or the one that starts it; real-time safe.
  void beat(Worker worker) { at(worker).store(now_ns(), std::memory_order_relaxed); }

  /// It has done its last work. The worker's own thread.
  void end(Worker worker) { at(worker).store(kNotAtWork, std::memory_order_relaxed); }

  /// The worker that was silent for the longest time; none where none is at work. Any thread.
  std::optional<Silence> longest_silence() const {
    const std::int64_t now = now_ns();
    std::optional<Silence> longest;
    for (std::size_t w = 0; w < last_ns_.size(); ++w) {
      const std::int64_t last = last_ns_[w].load(std::memory_order_relaxed);
      const std::chrono::nanoseconds length(now - last);
      if (last != kNotAtWork && (!longest || length > longest->length)) {
        longest = Silence{static_cast<Worker>(w), length};
      }
    }
    return longest;
  }

 private:
  static constexpr std::int64_t kNotAtWork = -1;

  static std::int64_t now_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }
  std::atomic<std::int64_t>& at(Worker worker) { return last_ns_.at(static_cast<std::size_t>(worker)); }

  std::array<std::atomic<std::int64_t>, 3> last_ns_{kNotAtWork, kNotAtWork, kNotAtWork};  ///< CLOCK_MONOTONIC
};

/// Name of a worker's thread.
inline const char* to_string(Worker worker) {
  constexpr std::array kNames = {"facet-capture", "facet-track", "facet-refine"};
  return kNames.at(static_cast<std::size_t>(worker));
}

}  // namespace facet::pipeline
