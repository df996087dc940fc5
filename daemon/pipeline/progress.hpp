#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "facet/clock.hpp"

namespace facet::pipeline {

/// When each worker (a thread that must get on for its pipeline to be alive) was last seen to get on, for
/// whoever must notice that one hangs. A worker says so with every piece of work and while it waits for
/// another one (BoundedQueue wakes it for that), so that silence means one thing: it is stuck inside a piece
/// of work, or is not run at all.
class Progress {
 public:
  struct Silence {
    std::string worker;  ///< name of its thread
    std::chrono::nanoseconds length{0};
  };

  /// The names of the workers' threads; they are counted in this order.
  explicit Progress(std::vector<std::string> workers)
      : workers_(std::move(workers)), last_ns_(workers_.size()) {
    for (std::size_t w = 0; w < workers_.size(); ++w) {
      end(w);
    }
  }

  const std::string& name(std::size_t worker) const { return workers_.at(worker); }

  /// It begins, or gets on. The worker's own thread, or the one that starts it; real-time safe.
  void beat(std::size_t worker) { last_ns_.at(worker).store(Clock::now_ns(), std::memory_order_relaxed); }

  /// It has done its last work. The worker's own thread.
  void end(std::size_t worker) { last_ns_.at(worker).store(kNotAtWork, std::memory_order_relaxed); }

  /// The worker that was silent for the longest time; none where none is at work. Any thread.
  std::optional<Silence> longest_silence() const {
    const std::int64_t now = Clock::now_ns();
    std::optional<Silence> longest;
    for (std::size_t w = 0; w < last_ns_.size(); ++w) {
      const std::int64_t last = last_ns_[w].load(std::memory_order_relaxed);
      const std::chrono::nanoseconds length(now - last);
      if (last != kNotAtWork && (!longest || length > longest->length)) {
        longest = Silence{workers_[w], length};
      }
    }
    return longest;
  }

 private:
  static constexpr std::int64_t kNotAtWork = -1;

  std::vector<std::string> workers_;
  std::vector<std::atomic<std::int64_t>> last_ns_;  ///< CLOCK_MONOTONIC
};

}  // namespace facet::pipeline
