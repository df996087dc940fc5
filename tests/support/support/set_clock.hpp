#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>

#include "facet/clock.hpp"

namespace facet::test {

/// A clock that stands until the test sets it, the whole process's while it lives.
class SetClock final : public TimeSource {
 public:
  explicit SetClock(std::int64_t now_ns, std::chrono::sys_seconds utc = {}) : now_ns_(now_ns), utc_(utc) {}

  void set(std::int64_t now_ns) { now_ns_ = now_ns; }

  Clock::time_point now() const noexcept override { return Clock::at(now_ns_); }
  std::chrono::system_clock::time_point utc() const noexcept override { return utc_; }

 private:
  std::atomic<std::int64_t> now_ns_;
  std::chrono::sys_seconds utc_;
  InstalledClock installed_{*this};
};

}  // namespace facet::test
