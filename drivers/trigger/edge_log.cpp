#include "trigger/edge_log.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>

#include "facet/error.hpp"

namespace facet::trigger {
namespace {

constexpr std::string_view kTitle = "facet-edges 1";
constexpr std::size_t kMaxEvents = kMostLoggedEvents;
constexpr std::size_t kLongestQuote = 40;
constexpr std::array<std::string_view, 5> kKinds = {"edge", "seen", "missing", "dropped", "fired"};
constexpr std::array<std::string_view, 2> kRoles = {"camera", "projector"};

/// The words of one line, read one after the other.
class Words {
 public:
  Words(std::string_view line, std::size_t number, const std::string& file)
      : rest_(line), number_(number), file_(file) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}:{}: {}", file_, number_, what));
  }

  std::string_view word() {
    const std::size_t end = std::min(rest_.find(' '), rest_.size());
    const std::string_view found = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    return found.empty() ? (fail("the line is too short"), found) : found;
  }

  /// A whole number below `end`.
  template <typename Number>
  Number number(Number end) {
    const std::string_view text = word();
    Number value = 0;
    const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || stop != text.data() + text.size() || value < 0 || value >= end) {
      fail(fmt::format("'{}' is no number from 0 to {}", text.substr(0, kLongestQuote), end - 1));
    }
    return value;
  }

  template <std::size_t Count>
  std::size_t choice(const std::array<std::string_view, Count>& allowed) {
    const std::string_view text = word();
    const auto at = std::find(allowed.begin(), allowed.end(), text);
    if (at == allowed.end()) {
      fail(fmt::format("'{}' is none of {}", text.substr(0, kLongestQuote), fmt::join(allowed, ", ")));
    }
    return static_cast<std::size_t>(at - allowed.begin());
  }

  void finish() const {
    if (!rest_.empty()) {
      fail("the line is too long");
    }
  }

 private:
  std::string_view rest_;
  std::size_t number_;
  const std::string& file_;
};

}  // namespace

std::string to_text(const EdgeLog& log) {
  std::string text = fmt::format("{}\n", kTitle);
  for (const TriggerLine& line : log.lines) {
    text += fmt::format("line {} {} {:d}\n", line.name, kRoles.at(static_cast<std::size_t>(line.role)),
                        line.safe_active);
  }
  for (const TriggerEvent& event : log.events) {
    text += to_text(event);
  }
  return text;
}

std::string to_text(const TriggerEvent& event) {
  return fmt::format("{} {} {:d} {} {} {} {} {}\n", kKinds.at(static_cast<std::size_t>(event.kind)),
                     event.line, event.active, event.slot, event.slot_count, event.planned_ns,
                     event.actual_ns, event.call_ns);
}

EdgeLog parse_edge_log(std::string_view text, const std::string& file) {
  // Times and slots of a computer that runs for centuries.
  constexpr std::int64_t kTimeEnd_ns = std::int64_t{1} << 62;
  constexpr std::uint64_t kSlotEnd = std::uint64_t{1} << 48;
  EdgeLog log;
  for (std::size_t number = 1; !text.empty(); ++number) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    Words words(text.substr(0, end), number, file);
    if (number == 1 && text.substr(0, end) != kTitle) {
      words.fail(fmt::format("is no edge log: '{}' is missing", kTitle));
    }
    if (number > 1 && text.substr(0, 5) == "line ") {
      words.word();
      TriggerLine line;
      line.name = words.word();
      line.role = static_cast<LineRole>(words.choice(kRoles));
      line.safe_active = words.number(2) == 1;
      words.finish();
      if (log.lines.size() == kMaxTriggerLines || !log.events.empty()) {
        words.fail(fmt::format("at most {} lines may stand before the events", kMaxTriggerLines));
      }
      log.lines.push_back(line);
    } else if (number > 1) {
      TriggerEvent event;
      event.kind = static_cast<TriggerEvent::Kind>(words.choice(kKinds));
      event.line = static_cast<std::uint8_t>(words.number(std::max<std::size_t>(1, log.lines.size())));
      event.active = words.number(2) == 1;
      event.slot = words.number(kSlotEnd);
      event.slot_count = words.number(kSlotEnd);
      event.planned_ns = words.number(kTimeEnd_ns);
      event.actual_ns = words.number(kTimeEnd_ns);
      event.call_ns = words.number(kTimeEnd_ns);
      words.finish();
      if (log.lines.empty() || log.events.size() == kMaxEvents) {
        words.fail(fmt::format("at most {} events may follow the lines", kMaxEvents));
      }
      log.events.push_back(event);
    }
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  if (log.events.empty()) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: holds no event", file));
  }
  return log;
}

}  // namespace facet::trigger
