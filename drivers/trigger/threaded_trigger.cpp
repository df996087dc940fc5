#include "trigger/threaded_trigger.hpp"

#include <pthread.h>
#include <sys/prctl.h>

#include <atomic>
#include <exception>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "trigger/event_ring.hpp"
#include "trigger/real_time.hpp"
#include "trigger/runner.hpp"

namespace facet::trigger {
namespace {

constexpr std::size_t kRingCapacity = 4096;

class MonotonicClock final : public TriggerClock {
 public:
  std::int64_t now_ns() override { return Clock::now_ns(); }
  void sleep_until(std::int64_t deadline_ns) override { Clock::sleep_until(Clock::at(deadline_ns)); }
};

class ThreadedTrigger final : public Trigger {
 public:
  ThreadedTrigger(const TriggerProgram& program, std::unique_ptr<TriggerLines> lines,
                  const ThreadOptions& options)
      : program_(program),
        lines_(std::move(lines)),
        options_(options),
        runner_(program_, *lines_, clock_, events_, counters_) {}
  ~ThreadedTrigger() override { ThreadedTrigger::stop(); }

  const TriggerProgram& program() const override { return program_; }

  void start(std::uint64_t first_slot) override {
    if (thread_.joinable() && state_now() == TriggerState::Running) {
      throw Error(ErrorKind::Internal, "the trigger runs already");
    }
    stop();
    stop_requested_ = false;
    set_state(TriggerState::Running, "");
    try {
      thread_ = std::jthread([this, first_slot] { run(first_slot); });
    } catch (const std::system_error& error) {
      set_state(TriggerState::Idle, "");
      throw Error(ErrorKind::Unavailable, std::string("no thread for the trigger: ") + error.what());
    }
  }

  bool next(TriggerEvent& out, std::chrono::milliseconds timeout) override {
    return events_.take(out, timeout);
  }

  void request_stop() override { stop_requested_ = true; }

  void stop() override {
    request_stop();
    if (thread_.joinable()) {
      thread_.join();
    }
  }

  TriggerStatus status() const override {
    TriggerStatus status;
    {
      const Lock lock(mutex_);
      status.state = state_;
      status.reason = reason_;
      status.real_time = scheduling_.granted;
      status.scheduling = scheduling_.description;
    }
    status.slots_fired = counters_.slots_fired;
    status.slots_dropped = counters_.slots_dropped;
    status.edges = counters_.edges;
    status.edges_late = counters_.edges_late;
    status.worst_late_ns = counters_.worst_late_ns;
    status.edges_proven = counters_.edges_proven;
    status.edges_missing = counters_.edges_missing;
    status.edges_stray = counters_.edges_stray;
    status.events_lost = events_.lost();
    return status;
  }

 private:
  TriggerState state_now() const {
    const Lock lock(mutex_);
    return state_;
  }

  void set_state(TriggerState state, const std::string& reason) {
    const Lock lock(mutex_);
    state_ = state;
    reason_ = reason;
  }

  void run(std::uint64_t first_slot) {
    try {
      run_program(first_slot);
    } catch (const std::exception& error) {
      set_state(TriggerState::Failing, error.what());
    }
  }

  void run_program(std::uint64_t first_slot) {
    ::pthread_setname_np(::pthread_self(), "facet-trigger");
    ::prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);  // for a thread that is not real-time: 50 us otherwise
    RealTime scheduling{false, "ordinary, as configured"};
    if (options_.real_time) {
      scheduling = become_real_time(options_.priority);
    }
    {
      const Lock lock(mutex_);
      scheduling_ = scheduling;
    }
    if (runner_.run(first_slot, stop_requested_)) {
      set_state(TriggerState::Idle, "");
    } else {
      set_state(TriggerState::Failing, lines_->last_error());
    }
  }

  TriggerProgram program_;
  std::unique_ptr<TriggerLines> lines_;
  ThreadOptions options_;
  MonotonicClock clock_;
  EventRing events_{kRingCapacity};
  RunCounters counters_;
  TriggerRunner runner_;
  std::atomic<bool> stop_requested_ = false;
  mutable Mutex mutex_;  ///< held for copies only, and by the edge thread only as it begins and ends
  TriggerState state_ FACET_GUARDED_BY(mutex_) = TriggerState::Idle;
  std::string reason_ FACET_GUARDED_BY(mutex_);
  RealTime scheduling_ FACET_GUARDED_BY(mutex_);
  std::jthread thread_;  ///< of the thread that starts and stops
};

}  // namespace

std::unique_ptr<Trigger> make_threaded_trigger(const TriggerProgram& program,
                                               std::unique_ptr<TriggerLines> lines,
                                               const ThreadOptions& options) {
  return std::make_unique<ThreadedTrigger>(program, std::move(lines), options);
}

}  // namespace facet::trigger
