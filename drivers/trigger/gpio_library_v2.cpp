// All that Facet says to libgpiod 2.

#include <fmt/format.h>
#include <gpiod.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <new>
#include <system_error>
#include <utility>

#include "facet/error.hpp"
#include "trigger/gpio_library.hpp"

namespace facet::trigger {
namespace {

template <auto Free>
struct Freed {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using ChipHandle = std::unique_ptr<gpiod_chip, Freed<&::gpiod_chip_close>>;
using ChipInfo = std::unique_ptr<gpiod_chip_info, Freed<&::gpiod_chip_info_free>>;
using LineInfo = std::unique_ptr<gpiod_line_info, Freed<&::gpiod_line_info_free>>;
using Settings = std::unique_ptr<gpiod_line_settings, Freed<&::gpiod_line_settings_free>>;
using LineConfig = std::unique_ptr<gpiod_line_config, Freed<&::gpiod_line_config_free>>;
using RequestConfig = std::unique_ptr<gpiod_request_config, Freed<&::gpiod_request_config_free>>;
using Request = std::shared_ptr<gpiod_line_request>;
using Events = std::shared_ptr<gpiod_edge_event_buffer>;

constexpr std::size_t kEventsAtOnce = 16;

/// What libgpiod makes; it gives nothing where memory is short, and where it was called wrongly.
template <typename T>
T made(T object) {
  if (object == nullptr) {
    throw std::bad_alloc();
  }
  return object;
}

std::string title_of(gpiod_chip* chip) {
  const ChipInfo info(::gpiod_chip_get_info(chip));
  return info != nullptr ? fmt::format("{} [{}]", ::gpiod_chip_info_get_name(info.get()),
                                       ::gpiod_chip_info_get_label(info.get()))
                         : ::gpiod_chip_get_path(chip);
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

gpiod_line_value value_of(int level) {
  return level != 0 ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
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
  gpiod_line_request* const request = ::gpiod_chip_request_lines(chip, config.get(), lines);
  return request != nullptr ? Request(request, ::gpiod_line_request_release) : nullptr;
}

class Chip final : public GpioChip {
 public:
  explicit Chip(ChipHandle chip) : chip_(std::move(chip)) {}

  std::string title() const override { return title_of(chip_.get()); }

  unsigned line_count() const override {
    const ChipInfo info(::gpiod_chip_get_info(chip_.get()));
    return info != nullptr ? static_cast<unsigned>(::gpiod_chip_info_get_num_lines(info.get())) : 0;
  }

  std::optional<unsigned> offset_of(const std::string& line_name) const override {
    const int offset = ::gpiod_chip_get_line_offset_from_name(chip_.get(), line_name.c_str());
    return offset >= 0 ? std::optional(static_cast<unsigned>(offset)) : std::nullopt;
  }

  std::optional<GpioLineInfo> line(unsigned offset) const override {
    const LineInfo line(::gpiod_chip_get_line_info(chip_.get(), offset));
    if (line == nullptr) {
      return std::nullopt;
    }
    const auto text = [](const char* value) { return std::string(value != nullptr ? value : ""); };
    return GpioLineInfo{text(::gpiod_line_info_get_name(line.get())), ::gpiod_line_info_is_used(line.get()),
                        text(::gpiod_line_info_get_consumer(line.get()))};
  }

  GpioOutputs drive(const std::string& consumer, std::span<const GpioWire> wires) override {
    const LineConfig lines(made(::gpiod_line_config_new()));
    std::vector<gpiod_line_value> values;
    for (const GpioWire& wire : wires) {
      const Settings settings(made(::gpiod_line_settings_new()));
      ::gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
      ::gpiod_line_settings_set_drive(settings.get(), drive_of(wire.drive));
      add_line(lines.get(), wire.offset, settings.get());
      values.push_back(value_of(wire.high ? 1 : 0));
    }
    if (::gpiod_line_config_set_output_values(lines.get(), values.data(), values.size()) != 0) {
      return {};
    }
    const Request request = request_lines(chip_.get(), consumer, lines.get());
    if (request == nullptr) {
      return {};
    }
    return [request, values](std::span<const int> levels) mutable {
      std::transform(levels.begin(), levels.end(), values.begin(), value_of);
      return ::gpiod_line_request_set_values(request.get(), values.data()) == 0;
    };
  }

  GpioInput watch(const std::string& consumer, unsigned offset) override {
    const Settings settings(made(::gpiod_line_settings_new()));
    ::gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_INPUT);
    ::gpiod_line_settings_set_edge_detection(settings.get(), GPIOD_LINE_EDGE_BOTH);
    ::gpiod_line_settings_set_event_clock(settings.get(), GPIOD_LINE_CLOCK_MONOTONIC);
    const LineConfig lines(made(::gpiod_line_config_new()));
    add_line(lines.get(), offset, settings.get());
    const Request request = request_lines(chip_.get(), consumer, lines.get());
    if (request == nullptr) {
      return {};
    }
    const Events events(made(::gpiod_edge_event_buffer_new(kEventsAtOnce)), ::gpiod_edge_event_buffer_free);
    return [request, events](std::span<GpioEdge> out) -> std::size_t {
      if (out.empty() || ::gpiod_line_request_wait_edge_events(request.get(), 0) != 1) {
        return 0;
      }
      const int read = ::gpiod_line_request_read_edge_events(request.get(), events.get(),
                                                             std::min(kEventsAtOnce, out.size()));
      for (int i = 0; i < read; ++i) {
        gpiod_edge_event* const event =
            ::gpiod_edge_event_buffer_get_event(events.get(), static_cast<unsigned long>(i));
        out[static_cast<std::size_t>(i)] = {
            ::gpiod_edge_event_get_event_type(event) == GPIOD_EDGE_EVENT_RISING_EDGE,
            static_cast<std::int64_t>(::gpiod_edge_event_get_timestamp_ns(event))};
      }
      return static_cast<std::size_t>(std::max(read, 0));
    };
  }

 private:
  ChipHandle chip_;
};

/// By name, label, number or device path; null, and errno, where there is none.
std::unique_ptr<GpioChip> open_chip(const std::string& wanted) {
  const auto opened = [](const std::string& path) {
    return ChipHandle(::gpiod_is_gpiochip_device(path.c_str()) ? ::gpiod_chip_open(path.c_str()) : nullptr);
  };
  for (const char* before : {"", "/dev/", "/dev/gpiochip"}) {
    errno = ENOENT;
    if (ChipHandle chip = opened(before + wanted); chip != nullptr) {
      return std::make_unique<Chip>(std::move(chip));
    }
    if (errno == EACCES) {
      return nullptr;
    }
  }
  for (const std::filesystem::path& device : chip_devices()) {
    ChipHandle chip = opened(device);
    const ChipInfo info(chip != nullptr ? ::gpiod_chip_get_info(chip.get()) : nullptr);
    if (info != nullptr && wanted == ::gpiod_chip_info_get_label(info.get())) {
      return std::make_unique<Chip>(std::move(chip));
    }
  }
  errno = ENOENT;
  return nullptr;
}

std::vector<std::string> chip_titles() {
  std::vector<std::string> titles;
  for (const std::filesystem::path& device : chip_devices()) {
    if (const ChipHandle chip(::gpiod_chip_open(device.c_str())); chip != nullptr) {
      titles.push_back(title_of(chip.get()));
    }
  }
  return titles;
}

}  // namespace

const GpioLibrary& system_gpio_library() {
  static const GpioLibrary library = {open_chip, chip_titles, true};
  return library;
}

}  // namespace facet::trigger
