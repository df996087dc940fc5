#pragma once

#include <chrono>
#include <cstddef>
#include <utility>
#include <vector>

#include "facet/mutex.hpp"

namespace facet::pipeline {

/// Frames on their way from one thread to the next: one thread pushes, one pops. Locks are held for a move
/// only. After close nothing goes in, what is inside comes out, then pop says that it is over. Whoever waits
/// is woken every kIdlePeriod to call `idle`, under the lock: it says that the thread is alive.
template <typename Item>
class BoundedQueue {
 public:
  static constexpr std::chrono::milliseconds kIdlePeriod{250};
  static constexpr auto kNoIdle = [] {};

  explicit BoundedQueue(std::size_t capacity) : slots_(capacity) {}

  /// Waits for room. Returns false once closed.
  template <typename Idle = decltype(kNoIdle)>
  bool push(Item&& item, const Idle& idle = kNoIdle) {
    const Lock lock(mutex_);
    wait(idle, [&]() FACET_REQUIRES(mutex_) { return closed_ || count_ < slots_.size(); });
    return put(std::move(item));
  }

  /// Never waits: where there is no room the oldest item is thrown away. Returns false once closed.
  bool push_newest(Item&& item) {
    Item oldest;  // dies after the lock is gone
    return push_newest(std::move(item), oldest);
  }
  /// The same; what was thrown away is handed out, where something was.
  bool push_newest(Item&& item, Item& oldest) {
    const Lock lock(mutex_);
    if (count_ == slots_.size()) {
      oldest = take();
    }
    return put(std::move(item));
  }

  /// Waits for an item. Returns false once closed and empty.
  template <typename Idle = decltype(kNoIdle)>
  bool pop(Item& item, const Idle& idle = kNoIdle) {
    const Lock lock(mutex_);
    wait(idle, [&]() FACET_REQUIRES(mutex_) { return closed_ || count_ > 0; });
    return hand(item);
  }
  /// The same, for `timeout` at most: false also where nothing came.
  bool pop_within(Item& item, std::chrono::milliseconds timeout) {
    const Lock lock(mutex_);
    changed_.wait_for(mutex_, timeout, [&]() FACET_REQUIRES(mutex_) { return closed_ || count_ > 0; });
    return hand(item);
  }

  /// Waits until everything was popped. Returns false once closed.
  template <typename Idle = decltype(kNoIdle)>
  bool wait_until_empty(const Idle& idle = kNoIdle) {
    const Lock lock(mutex_);
    wait(idle, [&]() FACET_REQUIRES(mutex_) { return closed_ || count_ == 0; });
    return !closed_;
  }

  void close() {
    const Lock lock(mutex_);
    closed_ = true;
    changed_.notify_all();
  }

  /// Items that wait. Any thread.
  std::size_t size() const {
    const Lock lock(mutex_);
    return count_;
  }

 private:
  template <typename Idle, typename Ready>
  void wait(const Idle& idle, const Ready& ready) FACET_REQUIRES(mutex_) {
    while (!changed_.wait_for(mutex_, kIdlePeriod, ready)) {
      idle();
    }
  }

  bool put(Item&& item) FACET_REQUIRES(mutex_) {
    if (closed_) {
      return false;
    }
    slots_[(first_ + count_) % slots_.size()] = std::move(item);
    ++count_;
    changed_.notify_all();
    return true;
  }

  bool hand(Item& item) FACET_REQUIRES(mutex_) {
    if (count_ == 0) {
      return false;
    }
    item = take();
    changed_.notify_all();
    return true;
  }

  Item take() FACET_REQUIRES(mutex_) {
    Item item = std::exchange(slots_[first_], Item{});
    first_ = (first_ + 1) % slots_.size();
    --count_;
    return item;
  }

  mutable Mutex mutex_;
  Condition changed_;
  std::vector<Item> slots_ FACET_GUARDED_BY(mutex_);
  std::size_t first_ FACET_GUARDED_BY(mutex_) = 0;
  std::size_t count_ FACET_GUARDED_BY(mutex_) = 0;
  bool closed_ FACET_GUARDED_BY(mutex_) = false;
};

}  // namespace facet::pipeline
