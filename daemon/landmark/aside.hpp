#pragma once

#include <cstdint>
#include <exception>
#include <functional>
#include <string>
#include <thread>

#include "facet/mutex.hpp"

namespace facet::landmark {

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

  /// Whether what was begun is done, so that wait returns at once.
  bool ready();

  /// Until what was begun is done. Where the helper has not come to it, or could not be made, it is done
  /// here: a helper that gets no processor holds up nobody. Throws what the work threw.
  void wait();

 private:
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

}  // namespace facet::landmark
