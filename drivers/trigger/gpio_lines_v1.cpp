// All that Facet says to libgpiod 1.6.

#include <fmt/format.h>
#include <gpiod.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <map>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "trigger/gpio_lines.hpp"
#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

struct CloseChip {
  void operator()(gpiod_chip* chip) const { ::gpiod_chip_close(chip); }
};
using Chip = std::unique_ptr<gpiod_chip, CloseChip>;

[[noreturn]] void unavailable(const std::string& what) {
  throw Error(ErrorKind::Unavailable, what);
}

std::string chip_title(gpiod_chip* chip) {
  return fmt::format("{} [{}]", ::gpiod_chip_name(chip), ::gpiod_chip_label(chip));
}

/// The chips of this machine, for a message.
std::string known_chips() {
  std::string chips;
  if (gpiod_chip_iter* iterator = ::gpiod_chip_iter_new()) {
    while (gpiod_chip* chip = ::gpiod_chip_iter_next(iterator)) {
      chips += (chips.empty() ? "" : ", ") + chip_title(chip);
    }
    ::gpiod_chip_iter_free(iterator);
  }
  return chips.empty() ? "this machine shows no GPIO chip" : "this machine shows " + chips;
}

std::string known_lines(gpiod_chip* chip) {
  std::string lines;
  for (unsigned i = 0; i < ::gpiod_chip_num_lines(chip); ++i) {
    gpiod_line* line = ::gpiod_chip_get_line(chip, i);
    if (const char* name = line != nullptr ? ::gpiod_line_name(line) : nullptr) {
      lines += (lines.empty() ? "" : ", ") + std::string(name);
    }
  }
  return fmt::format("it has {} lines{}", ::gpiod_chip_num_lines(chip),
                     lines.empty() ? "" : ", named " + lines);
}

gpiod_line* find_line(gpiod_chip* chip, const std::string& wanted) {
  gpiod_line* line = ::gpiod_chip_find_line(chip, wanted.c_str());
  const bool digits = !wanted.empty() && wanted.size() < 6 &&
                      std::all_of(wanted.begin(), wanted.end(), [](char c) { return c >= '0' && c <= '9'; });
  if (line == nullptr && digits) {
    line = ::gpiod_chip_get_line(chip, static_cast<unsigned>(std::stoul(wanted)));
  }
  if (line == nullptr) {
    unavailable(fmt::format("GPIO chip {}: no line '{}'; {}", chip_title(chip), wanted, known_lines(chip)));
  }
  return line;
}

/// Why a request failed, with the holder where the line is taken.
[[noreturn]] void refused(gpiod_line* line, const std::string& name, int error) {
  ::gpiod_line_update(line);
  const char* given_name = ::gpiod_line_name(line);
  const std::string title = fmt::format("trigger line '{}': GPIO chip {}, line {} ({})", name,
                                        chip_title(::gpiod_line_get_chip(line)), ::gpiod_line_offset(line),
                                        given_name != nullptr ? given_name : "unnamed");
  if (::gpiod_line_is_used(line)) {
    const char* holder = ::gpiod_line_consumer(line);
    unavailable(fmt::format("{} is held by '{}'", title, holder != nullptr ? holder : "the kernel"));
  }
  unavailable(fmt::format("{}: {}", title, std::strerror(error)));
}

int drive_flags(LineDrive drive) {
  switch (drive) {
    case LineDrive::OpenDrain:
      return GPIOD_LINE_REQUEST_FLAG_OPEN_DRAIN;
    case LineDrive::OpenSource:
      return GPIOD_LINE_REQUEST_FLAG_OPEN_SOURCE;
    case LineDrive::PushPull:
      break;
  }
  return 0;
}

class GpioLines final : public TriggerLines {
 public:
  GpioLines(const TriggerProgram& program, const GpioTriggerConfig& config)
      : names_(program.lines.size()), safe_(safe_lines(program)), level_(safe_) {
    for (std::size_t i = 0; i < program.lines.size(); ++i) {
      names_[i] = program.lines[i].name;
      inverted_ |= program.lines[i].active_low ? LineMask{1} << i : 0;
    }
    take_outputs(config);
    take_read_backs(config);
  }

  ~GpioLines() override { GpioLines::set(~LineMask{0}, safe_); }

  bool set(LineMask which, LineMask active) override {
    level_ = (level_ & ~which) | (active & which);
    bool done = true;
    for (Group& group : groups_) {
      if ((group.mask & which) == 0) {
        continue;
      }
      const Values values = values_of(group);
      if (::gpiod_line_set_value_bulk(&group.lines, values.data()) != 0) {
        failed_group_ = static_cast<std::size_t>(&group - groups_.data());
        error_ = errno;
        done = false;
      }
    }
    return done;
  }

  LineMask read_back() const override { return read_back_; }

  std::size_t seen(std::span<SeenEdge> out) override {
    std::size_t count = 0;
    constexpr timespec kNow = {0, 0};
    for (const Input& input : inputs_) {
      while (count < out.size() && ::gpiod_line_event_wait(input.line, &kNow) == 1) {
        gpiod_line_event event = {};
        if (::gpiod_line_event_read(input.line, &event) != 0) {
          break;
        }
        const bool high = event.event_type == GPIOD_LINE_EVENT_RISING_EDGE;
        out[count++] = {input.proves, high != input.inverted,
                        event.ts.tv_sec * 1'000'000'000LL + event.ts.tv_nsec};
      }
    }
    return count;
  }

  std::string last_error() const override {
    if (error_ == 0) {
      return "";
    }
    const Group& group = groups_[failed_group_];
    return fmt::format("trigger line '{}' and others of GPIO chip {} can't be set: {}",
                       names_[group.indices.front()], group.chip_title, std::strerror(error_));
  }

 private:
  using Values = std::array<int, GPIOD_LINE_BULK_MAX_LINES>;
  /// Lines of one chip with one kind of drive: set by one call, which the kernel takes per request.
  struct Group {
    gpiod_line_bulk lines = GPIOD_LINE_BULK_INITIALIZER;
    std::vector<std::size_t> indices;  ///< of the program's lines, in the order of `lines`
    LineMask mask = 0;
    std::string chip_title;
  };
  struct Input {
    gpiod_line* line = nullptr;
    std::uint8_t proves = 0;
    bool inverted = false;
  };

  gpiod_chip* chip(const std::string& wanted) {
    Chip& chip = chips_[wanted];
    if (chip == nullptr) {
      chip.reset(::gpiod_chip_open_lookup(wanted.c_str()));
      if (chip == nullptr) {
        unavailable(fmt::format("GPIO chip '{}': {}; {}", wanted, chip_fault(errno), known_chips()));
      }
    }
    return chip.get();
  }

  std::size_t index_of(const std::string& name) const {
    return static_cast<std::size_t>(std::find(names_.begin(), names_.end(), name) - names_.begin());
  }

  /// Levels of a group's wires. Polarity is dealt with here: a request has one polarity for all its lines,
  /// and lines of both polarities must change in one call.
  Values values_of(const Group& group) const {
    Values values{};
    for (std::size_t i = 0; i < group.indices.size(); ++i) {
      values[i] = static_cast<int>((level_ ^ inverted_) >> group.indices[i] & 1);
    }
    return values;
  }

  void take_outputs(const GpioTriggerConfig& config) {
    std::map<std::pair<std::string, LineDrive>, Group> groups;
    for (const GpioOutput& output : config.outputs) {
      gpiod_chip* const on = chip(output.chip);
      Group& group = groups[{::gpiod_chip_name(on), output.drive}];
      gpiod_line* const line = find_line(on, output.line);
      if (::gpiod_line_is_used(line)) {
        refused(line, output.name, EBUSY);
      }
      ::gpiod_line_bulk_add(&group.lines, line);
      group.indices.push_back(index_of(output.name));
      group.mask |= LineMask{1} << group.indices.back();
      group.chip_title = chip_title(on);
    }
    for (auto& [key, group] : groups) {
      const gpiod_line_request_config request = {config.consumer.c_str(), GPIOD_LINE_REQUEST_DIRECTION_OUTPUT,
                                                 drive_flags(key.second)};
      if (::gpiod_line_request_bulk(&group.lines, &request, values_of(group).data()) != 0) {
        refuse_group(group, errno);
      }
      groups_.push_back(group);
    }
  }

  /// Names the line that somebody took since it was looked up, else the first one.
  [[noreturn]] void refuse_group(Group& group, int error) const {
    std::size_t guilty = 0;
    for (std::size_t i = 0; i < group.indices.size(); ++i) {
      gpiod_line* const line = gpiod_line_bulk_get_line(&group.lines, static_cast<unsigned>(i));
      if (::gpiod_line_update(line) == 0 && ::gpiod_line_is_used(line)) {
        guilty = i;
      }
    }
    refused(gpiod_line_bulk_get_line(&group.lines, static_cast<unsigned>(guilty)),
            names_[group.indices[guilty]], error);
  }

  void take_read_backs(const GpioTriggerConfig& config) {
    for (const GpioReadBack& input : config.read_backs) {
      gpiod_line* const line = find_line(chip(input.chip), input.line);
      if (::gpiod_line_is_used(line) ||
          ::gpiod_line_request_both_edges_events(line, config.consumer.c_str()) != 0) {
        refused(line, input.name, errno);
      }
      const std::size_t proves = index_of(input.name);
      inputs_.push_back({line, static_cast<std::uint8_t>(proves), input.active_low});
      read_back_ |= LineMask{1} << proves;
    }
  }

  std::map<std::string, Chip> chips_;  ///< own the lines: closing gives them back
  std::vector<std::string> names_;
  std::vector<Group> groups_;
  std::vector<Input> inputs_;
  LineMask safe_;
  LineMask level_;
  LineMask inverted_ = 0;
  LineMask read_back_ = 0;
  std::size_t failed_group_ = 0;
  int error_ = 0;
};

}  // namespace

std::unique_ptr<TriggerLines> open_gpio_lines(const TriggerProgram& program,
                                              const GpioTriggerConfig& config) {
  return std::make_unique<GpioLines>(program, config);
}

}  // namespace facet::trigger
