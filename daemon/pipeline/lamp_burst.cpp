#include "pipeline/lamp_burst.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <system_error>
#include <utility>

#include "trigger/gpio_lines.hpp"

namespace facet::pipeline {

LampBurst::LampBurst(std::unique_ptr<trigger::TriggerLines> lines, int count, int each_ms)
    : count_(count), each_ns_(std::int64_t{1'000'000} * each_ms), lines_(std::move(lines)) {}

LampBurst::~LampBurst() {
  end();
}

void LampBurst::begin(std::int64_t now_ns) {
  end();
  watcher_ = {};  // that of the burst before has nothing to wait for any more
  began_ns_ = now_ns;
  try {
    const Lock lock(mutex_);
    fault_.clear();
    show(0);
    if (step_ == 0) {
      watcher_ = std::jthread([this] { watch(); });
    }
  } catch (const std::system_error& error) {
    const Lock lock(mutex_);
    fault_ = fmt::format("no thread is to be had that watches over them: {}", error.code().message());
    put_out();
  }
}

bool LampBurst::go_on(std::int64_t now_ns) {
  const Lock lock(mutex_);
  if (step_ < 0) {
    return false;
  }
  const auto due = static_cast<int>(std::clamp<std::int64_t>((now_ns - began_ns_) / each_ns_, 0, count_ + 1));
  if (due > count_) {
    put_out();
  } else if (due != step_) {
    show(due);
  }
  return step_ >= 0;
}

void LampBurst::end() {
  const Lock lock(mutex_);
  if (step_ >= 0) {
    put_out();
  }
}

bool LampBurst::is_on() const {
  const Lock lock(mutex_);
  return step_ >= 0;
}

std::string LampBurst::fault() const {
  const Lock lock(mutex_);
  return fault_;
}

void LampBurst::show(int step) {
  step_ = step;
  if (!lines_->set(~LineMask{0}, step < count_ ? LineMask{1} << step : 0)) {
    fault_ = lines_->last_error();
    put_out();
  }
}

void LampBurst::put_out() {
  step_ = -1;
  if (!lines_->set(~LineMask{0}, 0)) {
    fault_ = "they may still be on: " + lines_->last_error();
  }
  ended_.notify_all();
}

void LampBurst::watch() {
  ::pthread_setname_np(::pthread_self(), "facet-lamps");
  const auto patience = std::chrono::nanoseconds((count_ + 1) * each_ns_) + std::chrono::seconds(1);
  const Lock lock(mutex_);
  if (!ended_.wait_for(mutex_, patience, [&]() FACET_REQUIRES(mutex_) { return step_ < 0; })) {
    fault_ = "no picture came for their end";
    put_out();
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
