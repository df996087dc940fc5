#pragma once

#include <atomic>
#include <cstddef>
#include <span>
#include <string>

#include "trigger/lines.hpp"

namespace facet::test {

/// Lines without wires: which are active is seen in `on`, which outlives them.
class LampLines final : public trigger::TriggerLines {
 public:
  explicit LampLines(std::atomic<LineMask>& on) : on_(on) { on_ = 0; }
  ~LampLines() override { on_ = 0; }

  bool set(LineMask which, LineMask active) override {
    if (fails) {
      return false;
    }
    on_ = (on_ & ~which) | (active & which);
    return true;
  }
  LineMask read_back() const override { return 0; }
  std::size_t seen(std::span<trigger::SeenEdge> /*out*/) override { return 0; }
  std::string last_error() const override { return "line 1 was pulled out"; }

  std::atomic<bool> fails = false;

 private:
  std::atomic<LineMask>& on_;
};

}  // namespace facet::test
