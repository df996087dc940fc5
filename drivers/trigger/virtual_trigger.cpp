#include "trigger/virtual_trigger.hpp"

#include <array>
#include <bit>
#include <chrono>
#include <utility>

#include "facet/clock.hpp"
#include "trigger/lines.hpp"
#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

class VirtualLines final : public TriggerLines {
 public:
  VirtualLines(LineMask safe, VirtualTriggerOptions options)
      : safe_(safe), level_(safe), options_(std::move(options)) {}
  ~VirtualLines() override {
    if (level_ != safe_) {
      VirtualLines::set(~LineMask{0}, safe_);
    }
  }

  bool set(LineMask which, LineMask active) override {
    const LineMask changed = which & (level_ ^ active);
    level_ ^= changed;
    const std::int64_t now_ns = Clock::now_ns();
    for (LineMask rest = changed & options_.read_back; rest != 0; rest &= rest - 1) {
      const int line = std::countr_zero(rest);
      if (seen_count_ < seen_.size()) {
        seen_[seen_count_++] = {static_cast<std::uint8_t>(line), (level_ >> line & 1) != 0, now_ns};
      }
    }
    if (changed != 0 && options_.on_change) {
      options_.on_change(level_, now_ns);
    }
    return true;
  }

  LineMask read_back() const override { return options_.read_back; }

  std::size_t seen(std::span<SeenEdge> out) override {
    const std::size_t count = std::min(out.size(), seen_count_);
    const auto begin = seen_.begin();
    std::copy_n(begin, count, out.begin());
    std::move(begin + static_cast<std::ptrdiff_t>(count), begin + static_cast<std::ptrdiff_t>(seen_count_),
              begin);
    seen_count_ -= count;
    return count;
  }

  std::string last_error() const override { return ""; }

 private:
  LineMask safe_;
  LineMask level_;
  VirtualTriggerOptions options_;
  std::array<SeenEdge, 4 * kMaxTriggerLines> seen_{};
  std::size_t seen_count_ = 0;
};

}  // namespace

std::unique_ptr<Trigger> make_virtual_trigger(const TriggerProgram& program, VirtualTriggerOptions options) {
  const ThreadOptions thread = options.thread;
  return make_threaded_trigger(
      program, std::make_unique<VirtualLines>(safe_lines(program), std::move(options)), thread);
}

}  // namespace facet::trigger
