#pragma once

#include <deque>
#include <functional>
#include <string>
#include <thread>

#include "facet/mutex.hpp"

namespace facet::service {

/// Work that may take long (files, syncs, much to compute) on a thread of its own, one piece after the other
/// in the order in which it was asked for, so that the daemon's loop waits for none of it.
class Errands {
 public:
  /// thread_name: at most 15 bytes, as the system shows it.
  explicit Errands(std::string thread_name) : thread_name_(std::move(thread_name)) {}
  ~Errands();
  Errands(const Errands&) = delete;
  Errands& operator=(const Errands&) = delete;

  /// Throws std::system_error where the system gives no thread; nothing is left behind then.
  void start();
  /// Any thread, returns at once. What is asked for after request_stop, or waits then, is not done. `work`
  /// deals with its own errors: what it throws is dropped.
  void ask(std::function<void()> work);

  void request_stop();    ///< first phase; any thread, idempotent
  bool finished() const;  ///< the thread has ended, or never began
  void stop();            ///< second phase: the piece in work is finished

 private:
  void run();

  const std::string thread_name_;
  mutable Mutex mutex_;  ///< not held while something is done
  Condition woken_;
  std::deque<std::function<void()>> waiting_ FACET_GUARDED_BY(mutex_);
  bool stopping_ FACET_GUARDED_BY(mutex_) = false;
  bool ended_ FACET_GUARDED_BY(mutex_) = true;
  std::jthread thread_;
};

}  // namespace facet::service
