#include "landmark/aside.hpp"

#include <pthread.h>
#include <unistd.h>

#include <system_error>
#include <utility>

namespace facet::landmark {
namespace {

constexpr int kNice = 10;

}  // namespace

Aside::Aside(std::string name, std::function<void()> work) : name_(std::move(name)), work_(std::move(work)) {}

Aside::~Aside() {
  const Lock lock(mutex_);
  stop_ = true;
  changed_.notify_all();
}

void Aside::begin() {
  make_helper();
  begun_ = true;
  const Lock lock(mutex_);
  state_ = State::Asked;
  changed_.notify_all();
}

bool Aside::ready() {
  const Lock lock(mutex_);
  return state_ == State::Done;
}

void Aside::wait() {
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

void Aside::make_helper() {
  if (helper_.joinable()) {
    return;
  }
  try {
    helper_ = std::jthread([this] { help(); });
  } catch (const std::system_error&) {
    // The work is done by whoever waits for it; the next one asks for a thread again.
  }
}

void Aside::help() {
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

void Aside::work_and_note() noexcept {
  try {
    work_();
  } catch (...) {
    thrown_ = std::current_exception();
  }
}

}  // namespace facet::landmark
