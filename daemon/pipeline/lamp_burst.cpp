#include "pipeline/lamp_burst.hpp"

#include <algorithm>
#include <utility>

#include "trigger/gpio_lines.hpp"

namespace facet::pipeline {

LampBurst::LampBurst(std::unique_ptr<trigger::TriggerLines> lines, int count, int each_ms)
    : lines_(std::move(lines)), count_(count), each_ns_(std::int64_t{1'000'000} * each_ms) {}

void LampBurst::begin(std::int64_t now_ns) {
  fault_.clear();
  began_ns_ = now_ns;
  show(0);
}

bool LampBurst::go_on(std::int64_t now_ns) {
  if (!is_on()) {
    return false;
  }
  const auto due = static_cast<int>(std::clamp<std::int64_t>((now_ns - began_ns_) / each_ns_, 0, count_ + 1));
  if (due > count_) {
    end();
  } else if (due != step_) {
    show(due);
  }
  return is_on();
}

void LampBurst::end() {
  if (is_on()) {
    step_ = -1;
    lines_->set(~LineMask{0}, 0);
  }
}

void LampBurst::show(int step) {
  step_ = step;
  if (!lines_->set(~LineMask{0}, step < count_ ? LineMask{1} << step : 0)) {
    fault_ = lines_->last_error();
    end();
  }
}

std::unique_ptr<LampBurst> open_lamps(const LampsConfig& config) {
  if (config.outputs.empty()) {
    return nullptr;
  }
  TriggerProgram program;
  for (const trigger::GpioOutput& output : config.outputs) {
    TriggerLine& line = program.lines.emplace_back();
    line.name = output.name;
    line.role = LineRole::Projector;
    line.active_low = config.active_low;
  }
  trigger::GpioTriggerConfig wiring;
  wiring.outputs = config.outputs;
  wiring.consumer = "facet lamps";
  return std::make_unique<LampBurst>(trigger::open_gpio_lines(program, wiring),
                                     static_cast<int>(config.outputs.size()), config.each_ms);
}

}  // namespace facet::pipeline
