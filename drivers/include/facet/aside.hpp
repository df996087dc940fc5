#pragma once

#include <pthread.h>
#include <unistd.h>

#include <cstdint>
#include <exception>
#include <functional>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

#include "facet/mutex.hpp"

namespace facet {

/// One piece of work that is done again and again beside the thread that asks for it, on a helper thread of
/// its own that gives way to others (nice 10). begin, ready and wait: one thread. The first `begin` makes the
/// helper; it ends with this object, which waits for the piece under way.
class Aside {
 public:
  /// name: the helper's, at most 15 characters. work: what it needs is left alone between begin and wait.
  Aside(std::string name, std::function<void()> work);
  ~Aside();
  Aside(const Aside&) = delete;
  Aside& operator=(const Aside&) = delete;

  /// Hands the work over, at once. Between two calls there is one of wait.
  void begin();

  /// Whether begin was called and wait was not.
  bool begun() const { return begun_; }

  /// Whether there is a helper: where none could be made nothing becomes ready, and wait works.
  bool helped() const { return helper_.joinable(); }

  /// Whether what was begun is done, so that wait returns at once.
  bool ready();

  /// Until what was begun is done. Where the helper has not come to it, or could not be made, it is done
  /// here: a helper that gets no processor holds up nobody. Throws what the work threw.
  void wait();

 private:
  static constexpr int kNice = 10;
  enum class State : std::uint8_t { Idle, Asked, AtWork, Done };

  void make_helper();
  void help();
  void work_and_note() noexcept;

  std::string name_;
  std::function<void()> work_;
  bool begun_ = false;
  std::exception_ptr thrown_;  ///< by whoever works; read once it is done

  Mutex mutex_;
  Condition changed_;
  State state_ FACET_GUARDED_BY(mutex_) = State::Idle;
  bool stop_ FACET_GUARDED_BY(mutex_) = false;
  std::jthread helper_;
};

inline Aside::Aside(std::string name, std::function<void()> work)
    : name_(std::move(name)), work_(std::move(work)) {}

inline Aside::~Aside() {
  const Lock lock(mutex_);
  stop_ = true;
  changed_.notify_all();
}

inline void Aside::begin() {
  make_helper();
  begun_ = true;
  const Lock lock(mutex_);
  state_ = State::Asked;
  changed_.notify_all();
}

inline bool Aside::ready() {
  const Lock lock(mutex_);
  return state_ == State::Done;
}

inline void Aside::wait() {
  bool here = false;
  {
    const Lock lock(mutex_);
    here = state_ == State::Asked;
    if (here) {
      state_ = State::AtWork;
    } else {
      changed_.wait(mutex_, [&]() FACET_REQUIRES(mutex_) { return state_ != State::AtWork; });
    }
  }
  if (here) {
    work_and_note();
  }
  {
    const Lock lock(mutex_);
    state_ = State::Idle;
  }
  begun_ = false;
  if (const std::exception_ptr thrown = std::exchange(thrown_, nullptr)) {
    std::rethrow_exception(thrown);
  }
}

inline void Aside::make_helper() {
  if (helper_.joinable()) {
    return;
  }
  try {
    helper_ = std::jthread([this] { help(); });
  } catch (const std::system_error&) {
    // The work is done by whoever waits for it; the next one asks for a thread again.
  }
}

inline void Aside::help() {
  ::pthread_setname_np(::pthread_self(), name_.c_str());
  [[maybe_unused]] const int ignored = ::nice(kNice);  // refused, it works at the usual priority
  for (;;) {
    {
      const Lock lock(mutex_);
      changed_.wait(mutex_, [&]() FACET_REQUIRES(mutex_) { return stop_ || state_ == State::Asked; });
      if (stop_) {
        return;
      }
      state_ = State::AtWork;
    }
    work_and_note();
    const Lock lock(mutex_);
    state_ = State::Done;
    changed_.notify_all();
  }
}

inline void Aside::work_and_note() noexcept {
  try {
    work_();
  } catch (...) {
    thrown_ = std::current_exception();
  }
}

}  // namespace facet
