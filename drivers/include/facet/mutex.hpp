#pragma once

#include <condition_variable>
#include <mutex>
#include <utility>

#include "facet/thread_annotations.hpp"

namespace facet {

/// std::mutex with attributes, which libstdc++'s has not.
class FACET_CAPABILITY("mutex") Mutex {
 public:
  void lock() FACET_ACQUIRE() { mutex_.lock(); }
  void unlock() FACET_RELEASE() { mutex_.unlock(); }

 private:
  friend class Condition;
  std::mutex mutex_;
};

/// Holds a mutex while it lives.
class FACET_SCOPED_CAPABILITY Lock {
 public:
  explicit Lock(Mutex& mutex) FACET_ACQUIRE(mutex) : mutex_(mutex) { mutex_.lock(); }
  ~Lock() FACET_RELEASE() { mutex_.unlock(); }
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;

 private:
  Mutex& mutex_;
};

/// Lets go of a held mutex while it lives, for work of which others shall not wait.
class FACET_SCOPED_CAPABILITY Unlock {
 public:
  explicit Unlock(Mutex& mutex) FACET_RELEASE(mutex) : mutex_(mutex) { mutex_.unlock(); }
  ~Unlock() FACET_RELEASE() { mutex_.lock(); }
  Unlock(const Unlock&) = delete;
  Unlock& operator=(const Unlock&) = delete;

 private:
  Mutex& mutex_;
};

/// std::condition_variable whose waits take the held mutex. What is waited for is a lambda that says so:
/// changed_.wait(mutex_, [&]() FACET_REQUIRES(mutex_) { return stop_; }).
class Condition {
 public:
  void notify_one() { condition_.notify_one(); }
  void notify_all() { condition_.notify_all(); }

  /// As std::condition_variable's: nothing, std::cv_status, or whether what is waited for holds.
  template <typename... Ready>
  void wait(Mutex& mutex, Ready&&... ready) FACET_REQUIRES(mutex) {
    Held held(mutex);
    condition_.wait(held.lock, std::forward<Ready>(ready)...);
  }
  template <typename Duration, typename... Ready>
  auto wait_for(Mutex& mutex, const Duration& patience, Ready&&... ready) FACET_REQUIRES(mutex) {
    Held held(mutex);
    return condition_.wait_for(held.lock, patience, std::forward<Ready>(ready)...);
  }
  template <typename Time, typename... Ready>
  auto wait_until(Mutex& mutex, const Time& until, Ready&&... ready) FACET_REQUIRES(mutex) {
    Held held(mutex);
    return condition_.wait_until(held.lock, until, std::forward<Ready>(ready)...);
  }

 private:
  /// A mutex that is held before and after, in the form in which std::condition_variable wants it.
  struct Held {
    explicit Held(Mutex& mutex) : lock(mutex.mutex_, std::adopt_lock) {}
    ~Held() { lock.release(); }
    Held(const Held&) = delete;
    Held& operator=(const Held&) = delete;
    std::unique_lock<std::mutex> lock;
  };

  std::condition_variable condition_;
};

}  // namespace facet
