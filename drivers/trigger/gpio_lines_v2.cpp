// All that Facet says to libgpiod 2.

#include <fmt/format.h>
#include <gpiod.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <new>
#include <system_error>
#include <vector>

#include "facet/error.hpp"
#include "trigger/gpio_lines.hpp"
#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

template <auto Free>
struct Freed {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using Chip = std::unique_ptr<gpiod_chip, Freed<&::gpiod_chip_close>>;
using ChipInfo = std::unique_ptr<gpiod_chip_info, Freed<&::gpiod_chip_info_free>>;
using LineInfo = std::unique_ptr<gpiod_line_info, Freed<&::gpiod_line_info_free>>;
using Settings = std::unique_ptr<gpiod_line_settings, Freed<&::gpiod_line_settings_free>>;
using LineConfig = std::unique_ptr<gpiod_line_config, Freed<&::gpiod_line_config_free>>;
using RequestConfig = std::unique_ptr<gpiod_request_config, Freed<&::gpiod_request_config_free>>;
using Request = std::unique_ptr<gpiod_line_request, Freed<&::gpiod_line_request_release>>;
using Events = std::unique_ptr<gpiod_edge_event_buffer, Freed<&::gpiod_edge_event_buffer_free>>;

constexpr std::size_t kEventsAtOnce = 16;

[[noreturn]] void unavailable(const std::string& what) {
  throw Error(ErrorKind::Unavailable, what);
}

/// What libgpiod makes; it gives nothing where memory is short, and where it was called wrongly.
template <typename T>
T made(T object) {
  if (object == nullptr) {
    throw std::bad_alloc();
  }
  return object;
}

std::string title_of(gpiod_chip_info* info) {
  return fmt::format("{} [{}]", ::gpiod_chip_info_get_name(info), ::gpiod_chip_info_get_label(info));
}

std::string chip_title(gpiod_chip* chip) {
  const ChipInfo info(::gpiod_chip_get_info(chip));
  return info != nullptr ? title_of(info.get()) : ::gpiod_chip_get_path(chip);
}

/// The character devices that may be chips, in the order of their names.
std::vector<std::filesystem::path> chip_devices() {
  std::vector<std::filesystem::path> devices;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored)) {
    if (entry.path().filename().string().rfind("gpiochip", 0) == 0 &&
        ::gpiod_is_gpiochip_device(entry.path().c_str())) {
      devices.push_back(entry.path());
    }
  }
  std::sort(devices.begin(), devices.end());
  return devices;
}

/// The chips of this machine, for a message.
std::string known_chips() {
  std::string chips;
  for (const std::filesystem::path& device : chip_devices()) {
    if (const Chip chip(::gpiod_chip_open(device.c_str())); chip != nullptr) {
      chips += (chips.empty() ? "" : ", ") + chip_title(chip.get());
    }
  }
  return chips.empty() ? "this machine shows no GPIO chip" : "this machine shows " + chips;
}

/// By name, label, number or device path; null, and errno, where there is none.
Chip open_chip(const std::string& wanted) {
  const auto opened = [](const std::string& path) {
    return Chip(::gpiod_is_gpiochip_device(path.c_str()) ? ::gpiod_chip_open(path.c_str()) : nullptr);
  };
  for (const char* before : {"", "/dev/", "/dev/gpiochip"}) {
    errno = ENOENT;
    if (Chip chip = opened(before + wanted); chip != nullptr || errno == EACCES) {
      return chip;
    }
  }
  for (const std::filesystem::path& device : chip_devices()) {
    Chip chip = opened(device);
    const ChipInfo info(chip != nullptr ? ::gpiod_chip_get_info(chip.get()) : nullptr);
    if (info != nullptr && wanted == ::gpiod_chip_info_get_label(info.get())) {
      return chip;
    }
  }
  errno = ENOENT;
  return nullptr;
}

std::string known_lines(gpiod_chip* chip) {
  const ChipInfo info(::gpiod_chip_get_info(chip));
  const std::size_t count = info != nullptr ? ::gpiod_chip_info_get_num_lines(info.get()) : 0;
  std::string lines;
  for (unsigned i = 0; i < count; ++i) {
    const LineInfo line(::gpiod_chip_get_line_info(chip, i));
    if (const char* name = line != nullptr ? ::gpiod_line_info_get_name(line.get()) : nullptr) {
      lines += (lines.empty() ? "" : ", ") + std::string(name);
    }
  }
  return fmt::format("it has {} lines{}", count, lines.empty() ? "" : ", named " + lines);
}

unsigned find_line(gpiod_chip* chip, const std::string& wanted) {
  const int named = ::gpiod_chip_get_line_offset_from_name(chip, wanted.c_str());
  if (named >= 0) {
    return static_cast<unsigned>(named);
  }
  const bool digits = !wanted.empty() && wanted.size() < 6 &&
                      std::all_of(wanted.begin(), wanted.end(), [](char c) { return c >= '0' && c <= '9'; });
  const auto offset = digits ? static_cast<unsigned>(std::stoul(wanted)) : 0U;
  if (!digits || LineInfo(::gpiod_chip_get_line_info(chip, offset)) == nullptr) {
    unavailable(fmt::format("GPIO chip {}: no line '{}'; {}", chip_title(chip), wanted, known_lines(chip)));
  }
  return offset;
}

bool is_used(gpiod_chip* chip, unsigned offset) {
  const LineInfo line(::gpiod_chip_get_line_info(chip, offset));
  return line != nullptr && ::gpiod_line_info_is_used(line.get());
}

/// Why a request failed, with the holder where the line is taken.
[[noreturn]] void refused(gpiod_chip* chip, unsigned offset, const std::string& name, int error) {
  const LineInfo line(::gpiod_chip_get_line_info(chip, offset));
  const char* given_name = line != nullptr ? ::gpiod_line_info_get_name(line.get()) : nullptr;
  const std::string title =
      fmt::format("trigger line '{}': GPIO chip {}, line {} ({})", name, chip_title(chip), offset,
                  given_name != nullptr ? given_name : "unnamed");
  if (line != nullptr && ::gpiod_line_info_is_used(line.get())) {
    const char* holder = ::gpiod_line_info_get_consumer(line.get());
    unavailable(fmt::format("{} is held by '{}'", title, holder != nullptr ? holder : "the kernel"));
  }
  unavailable(fmt::format("{}: {}", title, std::strerror(error)));
}

gpiod_line_drive drive_of(LineDrive drive) {
  switch (drive) {
    case LineDrive::OpenDrain:
      return GPIOD_LINE_DRIVE_OPEN_DRAIN;
    case LineDrive::OpenSource:
      return GPIOD_LINE_DRIVE_OPEN_SOURCE;
    case LineDrive::PushPull:
      break;
  }
  return GPIOD_LINE_DRIVE_PUSH_PULL;
}

void add_line(gpiod_line_config* lines, unsigned offset, gpiod_line_settings* settings) {
  if (::gpiod_line_config_add_line_settings(lines, &offset, 1, settings) != 0) {
    throw Error(ErrorKind::Internal,
                fmt::format("libgpiod takes no line {} more: {}", offset, std::strerror(errno)));
  }
}

/// Null, and errno, where it was refused.
Request request_lines(gpiod_chip* chip, const std::string& consumer, gpiod_line_config* lines) {
  const RequestConfig config(made(::gpiod_request_config_new()));
  ::gpiod_request_config_set_consumer(config.get(), consumer.c_str());
  return Request(::gpiod_chip_request_lines(chip, config.get(), lines));
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
      if (::gpiod_line_request_set_values(group.request.get(), values.data()) != 0) {
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
    for (const Input& input : inputs_) {
      while (count < out.size() && ::gpiod_line_request_wait_edge_events(input.request.get(), 0) == 1) {
        const int read = ::gpiod_line_request_read_edge_events(input.request.get(), events_.get(),
                                                               std::min(kEventsAtOnce, out.size() - count));
        if (read <= 0) {
          break;
        }
        for (int i = 0; i < read; ++i) {
          gpiod_edge_event* const event =
              ::gpiod_edge_event_buffer_get_event(events_.get(), static_cast<unsigned long>(i));
          const bool high = ::gpiod_edge_event_get_event_type(event) == GPIOD_EDGE_EVENT_RISING_EDGE;
          out[count++] = {input.proves, high != input.inverted,
                          static_cast<std::int64_t>(::gpiod_edge_event_get_timestamp_ns(event))};
        }
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
  using Values = std::array<gpiod_line_value, 8 * sizeof(LineMask)>;
  /// Lines of one chip: set by one call, which the kernel takes per request.
  struct Group {
    Request request;
    std::vector<std::size_t> indices;  ///< of the program's lines, in the request's order
    std::vector<unsigned> offsets;     ///< of the same, on the chip
    LineMask mask = 0;
    std::string chip_title;
  };
  struct Input {
    Request request;
    std::uint8_t proves = 0;
    bool inverted = false;
  };

  gpiod_chip* chip(const std::string& wanted) {
    Chip& chip = chips_[wanted];
    if (chip == nullptr) {
      chip = open_chip(wanted);
      if (chip == nullptr) {
        unavailable(fmt::format("GPIO chip '{}': {}; {}", wanted, chip_fault(errno), known_chips()));
      }
    }
    return chip.get();
  }

  std::size_t index_of(const std::string& name) const {
    return static_cast<std::size_t>(std::find(names_.begin(), names_.end(), name) - names_.begin());
  }

  /// Levels of a group's wires; polarity is dealt with here.
  Values values_of(const Group& group) const {
    Values values{};
    for (std::size_t i = 0; i < group.indices.size(); ++i) {
      values[i] = (((level_ ^ inverted_) >> group.indices[i]) & 1) != 0 ? GPIOD_LINE_VALUE_ACTIVE
                                                                        : GPIOD_LINE_VALUE_INACTIVE;
    }
    return values;
  }

  void take_outputs(const GpioTriggerConfig& config) {
    struct Wanted {
      gpiod_chip* chip = nullptr;
      LineConfig lines{made(::gpiod_line_config_new())};
      Group group;
    };
    std::map<std::string, Wanted> chips;  // by title: a chip goes by several names
    for (const GpioOutput& output : config.outputs) {
      gpiod_chip* const on = chip(output.chip);
      Wanted& wanted = chips[chip_title(on)];
      wanted.chip = wanted.chip == nullptr ? on : wanted.chip;
      const unsigned offset = find_line(on, output.line);
      if (is_used(on, offset)) {
        refused(on, offset, output.name, EBUSY);
      }
      const Settings settings(made(::gpiod_line_settings_new()));
      ::gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
      ::gpiod_line_settings_set_drive(settings.get(), drive_of(output.drive));
      add_line(wanted.lines.get(), offset, settings.get());
      wanted.group.indices.push_back(index_of(output.name));
      wanted.group.offsets.push_back(offset);
      wanted.group.mask |= LineMask{1} << wanted.group.indices.back();
    }
    for (auto& [title, wanted] : chips) {
      Group& group = wanted.group;
      group.chip_title = title;
      const Values values = values_of(group);
      if (::gpiod_line_config_set_output_values(wanted.lines.get(), values.data(), group.indices.size()) ==
          0) {
        group.request = request_lines(wanted.chip, config.consumer, wanted.lines.get());
      }
      if (group.request == nullptr) {
        refuse_group(wanted.chip, group, errno);
      }
      groups_.push_back(std::move(group));
    }
  }

  /// Names the line that somebody took since it was looked up, else the first one.
  [[noreturn]] void refuse_group(gpiod_chip* on, const Group& group, int error) const {
    std::size_t guilty = 0;
    for (std::size_t i = 0; i < group.offsets.size(); ++i) {
      guilty = is_used(on, group.offsets[i]) ? i : guilty;
    }
    refused(on, group.offsets[guilty], names_[group.indices[guilty]], error);
  }

  void take_read_backs(const GpioTriggerConfig& config) {
    for (const GpioReadBack& input : config.read_backs) {
      gpiod_chip* const on = chip(input.chip);
      const unsigned offset = find_line(on, input.line);
      const Settings settings(made(::gpiod_line_settings_new()));
      ::gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_INPUT);
      ::gpiod_line_settings_set_edge_detection(settings.get(), GPIOD_LINE_EDGE_BOTH);
      ::gpiod_line_settings_set_event_clock(settings.get(), GPIOD_LINE_CLOCK_MONOTONIC);
      const LineConfig lines(made(::gpiod_line_config_new()));
      add_line(lines.get(), offset, settings.get());
      Request request = is_used(on, offset) ? nullptr : request_lines(on, config.consumer, lines.get());
      if (request == nullptr) {
        refused(on, offset, input.name, errno);
      }
      const std::size_t proves = index_of(input.name);
      inputs_.push_back({std::move(request), static_cast<std::uint8_t>(proves), input.active_low});
      read_back_ |= LineMask{1} << proves;
    }
  }

  std::map<std::string, Chip> chips_;
  std::vector<std::string> names_;
  std::vector<Group> groups_;
  std::vector<Input> inputs_;
  Events events_{made(::gpiod_edge_event_buffer_new(kEventsAtOnce))};
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
