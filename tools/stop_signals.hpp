#pragma once

#include <atomic>
#include <csignal>
#include <ctime>

namespace facet::tools {

/// While this lives SIGINT and SIGTERM end the work, not the process: what was made so far stays whole, what
/// is half written is taken away. Made before any thread starts.
class StopSignals {
 public:
  StopSignals() {
    sigemptyset(&set_);
    sigaddset(&set_, SIGINT);
    sigaddset(&set_, SIGTERM);
    ::pthread_sigmask(SIG_BLOCK, &set_, &before_);
  }
  ~StopSignals() { ::pthread_sigmask(SIG_SETMASK, &before_, nullptr); }
  StopSignals(const StopSignals&) = delete;
  StopSignals& operator=(const StopSignals&) = delete;

  /// Waits for one of the signals, `patience` at most; 0 where none came.
  int wait(const timespec& patience) const {
    const int signal = ::sigtimedwait(&set_, nullptr, &patience);
    return signal > 0 ? signal : 0;
  }
  /// The signal that has come, or 0; the same ever after, whichever thread asks.
  int pending() const {
    if (const int signal = wait({0, 0}); signal != 0) {
      seen_ = signal;
    }
    return seen_;
  }

  /// Ends the process as the signal would have, so that a calling shell sees what happened.
  void die_of(int signal) const {
    std::signal(signal, SIG_DFL);
    ::pthread_sigmask(SIG_UNBLOCK, &set_, nullptr);
    std::raise(signal);
  }

 private:
  sigset_t set_{};
  sigset_t before_{};
  mutable std::atomic<int> seen_{0};
};

}  // namespace facet::tools
