#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "facet/mutex.hpp"

namespace facet {

/// What threads have to say to people, for whoever owns them to log. Said on rare
/// events only (a device is lost, a subject is new), never per frame. Any thread.
class Messages {
 public:
  struct Message {
    bool warning = false;
    std::string text;
  };

  void info(std::string text) { add({false, std::move(text)}); }
  void warning(std::string text) { add({true, std::move(text)}); }

  /// Everything since the last call, oldest first.
  std::vector<Message> take() {
    const Lock lock(mutex_);
    return std::exchange(messages_, {});
  }

 private:
  /// More than this between two calls of take are not kept: nobody reads them.
  static constexpr std::size_t kMost = 1000;

  void add(Message message) {
    const Lock lock(mutex_);
    if (messages_.size() < kMost) {
      messages_.push_back(std::move(message));
    }
  }

  Mutex mutex_;
  std::vector<Message> messages_ FACET_GUARDED_BY(mutex_);
};

}  // namespace facet
