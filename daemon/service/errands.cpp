#include "service/errands.hpp"

#include <pthread.h>

#include <exception>
#include <utility>

#include "facet/mutex.hpp"

namespace facet::service {

Errands::~Errands() {
  stop();
}

void Errands::start() {
  const Lock lock(mutex_);
  thread_ = std::jthread([this] { run(); });
  ended_ = false;
}

void Errands::run() {
  ::pthread_setname_np(::pthread_self(), thread_name_.c_str());
  const Lock lock(mutex_);
  while (true) {
    woken_.wait(mutex_, [&]() FACET_REQUIRES(mutex_) { return stopping_ || !waiting_.empty(); });
    if (stopping_) {
      break;
    }
    std::function<void()> work = std::move(waiting_.front());
    waiting_.pop_front();
    const Unlock unlock(mutex_);
    try {
      work();
    } catch (const std::exception&) {
      // Said in the header: whoever asks deals with its errors. What is left is want of memory.
    }
    work = nullptr;
  }
  waiting_.clear();
  ended_ = true;
}

void Errands::ask(std::function<void()> work) {
  const Lock lock(mutex_);
  if (!stopping_) {
    waiting_.push_back(std::move(work));
    woken_.notify_one();
  }
}

void Errands::request_stop() {
  const Lock lock(mutex_);
  stopping_ = true;
  woken_.notify_one();
}

bool Errands::finished() const {
  const Lock lock(mutex_);
  return ended_;
}

void Errands::stop() {
  request_stop();
  if (thread_.joinable()) {
    thread_.join();
  }
}

}  // namespace facet::service
