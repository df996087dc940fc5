#pragma once

#include <chrono>
#include <functional>
#include <thread>

namespace facet::test {

/// Waits until `holds`, a minute at most: a test that passes never takes it.
inline bool eventually(const std::function<bool()>& holds) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
  while (!holds()) {
    if (std::chrono::steady_clock::now() > end) {
      return false;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace facet::test
