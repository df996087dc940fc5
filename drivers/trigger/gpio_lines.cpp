#include "trigger/gpio_lines.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <map>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

[[noreturn]] void unavailable(const std::string& what) {
  throw Error(ErrorKind::Unavailable, what);
}

/// Why a chip can't be opened, and what to do where rights are missing.
std::string chip_fault(int error) {
  std::string text = std::strerror(error);
  if (error == EACCES || error == EPERM) {
    text += " (its device is for a group, facet-gpio where the package is installed: sudo -u facet)";
  }
  return text;
}

/// The chips of this machine, for a message.
std::string known_chips(const GpioLibrary& library) {
  const std::vector<std::string> chips = library.chip_titles();
  return chips.empty() ? "this machine shows no GPIO chip"
                       : fmt::format("this machine shows {}", fmt::join(chips, ", "));
}

std::string known_lines(const GpioChip& chip) {
  std::vector<std::string> names;
  for (unsigned i = 0; i < chip.line_count(); ++i) {
    if (const auto line = chip.line(i); line && !line->name.empty()) {
      names.push_back(line->name);
    }
  }
  return fmt::format("it has {} lines{}{}", chip.line_count(), names.empty() ? "" : ", named ",
                     fmt::join(names, ", "));
}

/// By name, or by offset in digits.
unsigned find_line(const GpioChip& chip, const std::string& wanted) {
  if (const auto named = chip.offset_of(wanted)) {
    return *named;
  }
  const bool digits = !wanted.empty() && wanted.size() < 6 &&
                      std::all_of(wanted.begin(), wanted.end(), [](char c) { return c >= '0' && c <= '9'; });
  const auto offset = digits ? static_cast<unsigned>(std::stoul(wanted)) : 0U;
  if (!digits || !chip.line(offset)) {
    unavailable(fmt::format("GPIO chip {}: no line '{}'; {}", chip.title(), wanted, known_lines(chip)));
  }
  return offset;
}

bool is_used(const GpioChip& chip, unsigned offset) {
  const auto line = chip.line(offset);
  return line && line->used;
}

/// Why a request failed, with the holder where the line is taken.
[[noreturn]] void refused(const GpioChip& chip, unsigned offset, const std::string& name, int error) {
  const GpioLineInfo line = chip.line(offset).value_or(GpioLineInfo{});
  const std::string title = fmt::format("trigger line '{}': GPIO chip {}, line {} ({})", name, chip.title(),
                                        offset, line.name.empty() ? "unnamed" : line.name);
  if (line.used) {
    unavailable(fmt::format("{} is held by '{}'", title, line.holder.empty() ? "the kernel" : line.holder));
  }
  unavailable(fmt::format("{}: {}", title, std::strerror(error)));
}

class GpioLines final : public TriggerLines {
 public:
  GpioLines(const TriggerProgram& program, const GpioTriggerConfig& config, const GpioLibrary& library)
      : library_(library), names_(program.lines.size()), safe_(safe_lines(program)), level_(safe_) {
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
    for (const Group& group : groups_) {
      if ((group.mask & which) == 0) {
        continue;
      }
      std::array<int, 8 * sizeof(LineMask)> levels{};
      for (std::size_t i = 0; i < group.indices.size(); ++i) {
        levels[i] = is_high(group.indices[i]) ? 1 : 0;
      }
      if (!group.set(std::span(levels).first(group.indices.size()))) {
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
    std::array<GpioEdge, 16> edges;
    for (const Input& input : inputs_) {
      std::size_t read = 0;
      do {
        read = input.seen(std::span(edges).first(std::min(edges.size(), out.size() - count)));
        for (std::size_t i = 0; i < read; ++i) {
          out[count++] = {input.proves, edges[i].high != input.inverted, edges[i].time_ns};
        }
      } while (read > 0);
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
  /// Lines of one chip: set by one call, which the kernel takes per request.
  struct Group {
    std::string chip_title;
    GpioOutputs set;
    std::vector<std::size_t> indices;  ///< of the program's lines, in the request's order
    LineMask mask = 0;
  };
  struct Input {
    GpioInput seen;
    std::uint8_t proves = 0;
    bool inverted = false;
  };

  GpioChip& chip(const std::string& wanted) {
    std::unique_ptr<GpioChip>& chip = chips_[wanted];
    if (chip == nullptr) {
      chip = library_.open(wanted);
      if (chip == nullptr) {
        const int error = errno;
        unavailable(fmt::format("GPIO chip '{}': {}; {}", wanted, chip_fault(error), known_chips(library_)));
      }
    }
    return *chip;
  }

  std::size_t index_of(const std::string& name) const {
    return static_cast<std::size_t>(std::find(names_.begin(), names_.end(), name) - names_.begin());
  }

  /// Whether the wire of a line is high now. Polarity is dealt with here: a request may have one polarity for
  /// all its lines, and lines of both must change in one call.
  bool is_high(std::size_t index) const { return ((level_ ^ inverted_) >> index & 1) != 0; }

  void take_outputs(const GpioTriggerConfig& config) {
    struct Wanted {
      GpioChip* chip = nullptr;
      std::vector<GpioWire> wires;
      Group group;
    };
    std::map<std::pair<std::string, LineDrive>, Wanted> requests;  // by title: a chip goes by several names
    for (const GpioOutput& output : config.outputs) {
      GpioChip& on = chip(output.chip);
      const LineDrive drive = library_.mixes_drives ? LineDrive::PushPull : output.drive;
      Wanted& wanted = requests[{on.title(), drive}];
      wanted.chip = wanted.chip == nullptr ? &on : wanted.chip;
      const unsigned offset = find_line(on, output.line);
      if (is_used(on, offset)) {
        refused(on, offset, output.name, EBUSY);
      }
      const std::size_t index = index_of(output.name);
      wanted.wires.push_back({offset, output.drive, is_high(index)});
      wanted.group.indices.push_back(index);
      wanted.group.mask |= LineMask{1} << index;
    }
    for (auto& [key, wanted] : requests) {
      wanted.group.chip_title = key.first;
      wanted.group.set = wanted.chip->drive(config.consumer, wanted.wires);
      if (wanted.group.set == nullptr) {
        refuse(*wanted.chip, wanted.wires, wanted.group.indices, errno);
      }
      groups_.push_back(std::move(wanted.group));
    }
  }

  /// Names the line that somebody took since it was looked up, else the first one.
  [[noreturn]] void refuse(const GpioChip& on, std::span<const GpioWire> wires,
                           std::span<const std::size_t> indices, int error) const {
    std::size_t guilty = 0;
    for (std::size_t i = 0; i < wires.size(); ++i) {
      guilty = is_used(on, wires[i].offset) ? i : guilty;
    }
    refused(on, wires[guilty].offset, names_[indices[guilty]], error);
  }

  void take_read_backs(const GpioTriggerConfig& config) {
    for (const GpioReadBack& input : config.read_backs) {
      GpioChip& on = chip(input.chip);
      const unsigned offset = find_line(on, input.line);
      if (is_used(on, offset)) {
        refused(on, offset, input.name, EBUSY);
      }
      GpioInput line = on.watch(config.consumer, offset);
      if (line == nullptr) {
        refused(on, offset, input.name, errno);
      }
      const std::size_t proves = index_of(input.name);
      inputs_.push_back({std::move(line), static_cast<std::uint8_t>(proves), input.active_low});
      read_back_ |= LineMask{1} << proves;
    }
  }

  const GpioLibrary& library_;
  std::map<std::string, std::unique_ptr<GpioChip>> chips_;  ///< outlive what was requested of them
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

std::unique_ptr<TriggerLines> open_gpio_lines(const TriggerProgram& program, const GpioTriggerConfig& config,
                                              const GpioLibrary& library) {
  return std::make_unique<GpioLines>(program, config, library);
}

}  // namespace facet::trigger
