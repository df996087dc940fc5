#include "report/trigger_diagram.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace facet::report {
namespace {

using Colour = std::array<std::uint8_t, 3>;
using Kind = TriggerEvent::Kind;

constexpr Colour kPaper = {255, 255, 255};
constexpr Colour kInk = {30, 30, 40};
constexpr Colour kPale = {205, 208, 214};
constexpr Colour kPlanned = {235, 150, 40};
constexpr Colour kCamera = {25, 95, 180};
constexpr Colour kProjector = {20, 130, 80};
constexpr Colour kBad = {200, 40, 40};
constexpr int kLeft_px = 150;
constexpr int kRight_px = 190;
constexpr int kTop_px = 44;
constexpr int kRow_px = 52;
constexpr int kPlot_px = 960;
constexpr int kFoot_px = 48;

/// From times to places.
struct Axis {
  std::int64_t begin_ns = 0;
  std::int64_t end_ns = 1;
  float x(std::int64_t time_ns) const {
    const double part = static_cast<double>(time_ns - begin_ns) / static_cast<double>(end_ns - begin_ns);
    return static_cast<float>(kLeft_px + part * kPlot_px);
  }
  bool holds(std::int64_t time_ns) const { return time_ns >= begin_ns && time_ns <= end_ns; }
};

/// What of the log is shown: the slots before `end_slot`.
Axis axis_of(const trigger::EdgeLog& log, std::uint64_t end_slot) {
  Axis axis{log.events.front().planned_ns, log.events.front().planned_ns + 1};
  for (const TriggerEvent& event : log.events) {
    if (event.slot < end_slot) {
      axis.end_ns = std::max({axis.end_ns, event.planned_ns, event.actual_ns});
    }
  }
  const std::int64_t margin_ns = (axis.end_ns - axis.begin_ns) / 30 + 1;
  return {axis.begin_ns - margin_ns, axis.end_ns + margin_ns};
}

void thick_line(render::Picture& picture, Eigen::Vector2f a_px, Eigen::Vector2f b_px, Colour colour) {
  const Eigen::Vector2f across =
      std::abs(a_px.x() - b_px.x()) < 0.5F ? Eigen::Vector2f(1, 0) : Eigen::Vector2f(0, 1);
  render::draw_line(picture, a_px, b_px, colour);
  render::draw_line(picture, a_px + across, b_px + across, colour);
}

void draw_axis(render::Picture& picture, const Axis& axis, std::int64_t zero_ns, int bottom_px) {
  const double length_ms = static_cast<double>(axis.end_ns - axis.begin_ns) * 1e-6;
  double step_ms = std::pow(10.0, std::floor(std::log10(length_ms / 5)));
  step_ms *= length_ms / step_ms > 25 ? 5 : length_ms / step_ms > 10 ? 2 : 1;
  for (int i = 0; i * step_ms < length_ms; ++i) {
    const std::int64_t at_ns = zero_ns + std::llround(i * step_ms * 1e6);
    if (!axis.holds(at_ns)) {
      break;
    }
    const float x = axis.x(at_ns);
    render::draw_line(picture, {x, kTop_px}, {x, static_cast<float>(bottom_px)}, kPale, 0.7F);
    render::draw_text(picture, static_cast<int>(x) - 6, bottom_px + 6, fmt::format("{:g}", i * step_ms),
                      kInk);
  }
  render::draw_text(picture, kLeft_px + kPlot_px + 12, bottom_px + 6, "ms", kInk);
}

void draw_row(render::Picture& picture, const trigger::EdgeLog& log, std::size_t line, const Axis& axis,
              int top_px) {
  const Colour colour = log.lines[line].role == LineRole::Camera ? kCamera : kProjector;
  const auto y_of = [&](bool active) {
    return static_cast<float>(active ? top_px + 12 : top_px + kRow_px - 14);
  };
  bool level = log.lines[line].safe_active;
  float x = static_cast<float>(kLeft_px);
  std::int64_t worst_ns = 0;
  for (const TriggerEvent& event : log.events) {
    if (event.line != line || event.kind == Kind::Dropped || event.kind == Kind::Fired) {
      continue;
    }
    if (event.kind == Kind::Edge) {
      worst_ns = std::max(worst_ns, event.actual_ns - event.planned_ns);
    }
    if (!axis.holds(event.planned_ns)) {
      continue;
    }
    if (event.kind == Kind::Missing) {
      render::draw_text(picture, static_cast<int>(axis.x(event.planned_ns)) - 3, top_px + 18, "?", kBad);
    } else if (event.kind == Kind::Seen) {
      render::draw_dot(picture, {axis.x(event.actual_ns), (y_of(true) + y_of(false)) / 2}, 3, kInk);
    } else {
      const float planned_x = axis.x(event.planned_ns);
      render::draw_line(picture, {planned_x, y_of(true) - 6}, {planned_x, y_of(false) + 6}, kPlanned);
      const float edge_x = axis.x(event.actual_ns);
      thick_line(picture, {x, y_of(level)}, {edge_x, y_of(level)}, colour);
      thick_line(picture, {edge_x, y_of(true)}, {edge_x, y_of(false)}, colour);
      level = event.active;
      x = edge_x;
    }
  }
  thick_line(picture, {x, y_of(level)}, {static_cast<float>(kLeft_px + kPlot_px), y_of(level)}, colour);
  render::draw_text(picture, 10, top_px + kRow_px / 2 - 8, log.lines[line].name, colour);
  render::draw_text(picture, kLeft_px + kPlot_px + 12, top_px + kRow_px / 2 - 8,
                    fmt::format("latest edge +{:.0f} us", static_cast<double>(worst_ns) * 1e-3), kInk);
}

}  // namespace

render::Picture draw_trigger_diagram(const trigger::EdgeLog& log, std::uint64_t slot_count) {
  const std::uint64_t end_slot = log.events.front().slot + slot_count;
  const Axis axis = axis_of(log, end_slot);
  const int bottom_px = kTop_px + kRow_px * static_cast<int>(log.lines.size());
  render::Picture picture =
      render::plain_picture(kLeft_px + kPlot_px + kRight_px, bottom_px + kFoot_px, kPaper);
  draw_axis(picture, axis, log.events.front().planned_ns, bottom_px);
  for (const TriggerEvent& event : log.events) {
    if (event.slot < end_slot && axis.holds(event.planned_ns) &&
        (event.kind == Kind::Fired || event.kind == Kind::Dropped)) {
      const int x = static_cast<int>(axis.x(event.planned_ns));
      const bool fired = event.kind == Kind::Fired;
      render::draw_text(picture, x - 20, 12,
                        fired ? fmt::format("slot {} fires", event.slot)
                              : fmt::format("{} dropped from slot {}", event.slot_count, event.slot),
                        fired ? kInk : kBad);
      render::draw_line(picture, {static_cast<float>(x), 30},
                        {static_cast<float>(x), static_cast<float>(bottom_px)}, fired ? kPale : kBad);
    }
  }
  for (std::size_t line = 0; line < log.lines.size(); ++line) {
    draw_row(picture, log, line, axis, kTop_px + kRow_px * static_cast<int>(line));
  }
  render::draw_text(picture, 10, bottom_px + 28,
                    "orange: planned edge; dot: edge seen on the read-back line; ?: not seen there", kInk);
  return picture;
}

}  // namespace facet::report
