// All that Facet says to libgpiod 1.6.

#include <fmt/format.h>
#include <gpiod.h>

#include "trigger/gpio_library.hpp"

namespace facet::trigger {
namespace {

struct CloseChip {
  void operator()(gpiod_chip* chip) const { ::gpiod_chip_close(chip); }
};

std::string title_of(gpiod_chip* chip) {
  return fmt::format("{} [{}]", ::gpiod_chip_name(chip), ::gpiod_chip_label(chip));
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

class Chip final : public GpioChip {
 public:
  explicit Chip(gpiod_chip* chip) : chip_(chip) {}

  std::string title() const override { return title_of(chip_.get()); }
  unsigned line_count() const override { return ::gpiod_chip_num_lines(chip_.get()); }

  std::optional<unsigned> offset_of(const std::string& line_name) const override {
    gpiod_line* const line = ::gpiod_chip_find_line(chip_.get(), line_name.c_str());
    return line != nullptr ? std::optional(::gpiod_line_offset(line)) : std::nullopt;
  }

  std::optional<GpioLineInfo> line(unsigned offset) const override {
    gpiod_line* const line = ::gpiod_chip_get_line(chip_.get(), offset);
    if (line == nullptr || ::gpiod_line_update(line) != 0) {
      return std::nullopt;
    }
    const auto text = [](const char* value) { return std::string(value != nullptr ? value : ""); };
    return GpioLineInfo{text(::gpiod_line_name(line)), ::gpiod_line_is_used(line),
                        text(::gpiod_line_consumer(line))};
  }

  GpioOutputs drive(const std::string& consumer, std::span<const GpioWire> wires) override {
    gpiod_line_bulk lines = GPIOD_LINE_BULK_INITIALIZER;
    std::vector<int> levels;
    for (const GpioWire& wire : wires) {
      ::gpiod_line_bulk_add(&lines, ::gpiod_chip_get_line(chip_.get(), wire.offset));
      levels.push_back(wire.high ? 1 : 0);
    }
    const gpiod_line_request_config request = {consumer.c_str(), GPIOD_LINE_REQUEST_DIRECTION_OUTPUT,
                                               drive_flags(wires.front().drive)};
    if (::gpiod_line_request_bulk(&lines, &request, levels.data()) != 0) {
      return {};
    }
    return [lines](std::span<const int> set) mutable {
      return ::gpiod_line_set_value_bulk(&lines, set.data()) == 0;
    };
  }

  GpioInput watch(const std::string& consumer, unsigned offset) override {
    gpiod_line* const line = ::gpiod_chip_get_line(chip_.get(), offset);
    if (::gpiod_line_request_both_edges_events(line, consumer.c_str()) != 0) {
      return {};
    }
    return [line](std::span<GpioEdge> out) {
      std::size_t count = 0;
      constexpr timespec kNow = {0, 0};
      gpiod_line_event event = {};
      while (count < out.size() && ::gpiod_line_event_wait(line, &kNow) == 1 &&
             ::gpiod_line_event_read(line, &event) == 0) {
        out[count++] = {event.event_type == GPIOD_LINE_EVENT_RISING_EDGE,
                        event.ts.tv_sec * 1'000'000'000LL + event.ts.tv_nsec};
      }
      return count;
    };
  }

 private:
  std::unique_ptr<gpiod_chip, CloseChip> chip_;  ///< closing it gives its lines back
};

std::unique_ptr<GpioChip> open_chip(const std::string& wanted) {
  gpiod_chip* const chip = ::gpiod_chip_open_lookup(wanted.c_str());
  return chip != nullptr ? std::make_unique<Chip>(chip) : nullptr;
}

std::vector<std::string> chip_titles() {
  std::vector<std::string> titles;
  if (gpiod_chip_iter* iterator = ::gpiod_chip_iter_new()) {
    while (gpiod_chip* chip = ::gpiod_chip_iter_next(iterator)) {
      titles.push_back(title_of(chip));
    }
    ::gpiod_chip_iter_free(iterator);
  }
  return titles;
}

}  // namespace

const GpioLibrary& system_gpio_library() {
  // A request has one kind of drive for all its lines.
  static const GpioLibrary library = {open_chip, chip_titles, false};
  return library;
}

}  // namespace facet::trigger
