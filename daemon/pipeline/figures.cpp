#include "pipeline/figures.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "facet/clock.hpp"
#include "maths/statistics.hpp"

namespace facet::pipeline {

const char* to_string(LearningStatus::State state) {
  constexpr std::array kNames = {"looking", "solving", "learned"};
  return kNames.at(static_cast<std::size_t>(state));
}

const char* to_string(PipelineState state) {
  switch (state) {
    case PipelineState::Idle:
      return "idle";
    case PipelineState::Preparing:
      return "preparing";
    case PipelineState::Running:
      return "running";
    case PipelineState::Ended:
      return "ended";
    case PipelineState::Stopped:
      return "stopped";
    case PipelineState::Failed:
      return "failed";
  }
  return "unknown";
}

void Window::add(float value) {
  values_[next_] = value;
  next_ = (next_ + 1) % kLength;
  count_ = std::min(count_ + 1, kLength);
}

float Window::mean() const {
  return count_ == 0
             ? 0.0F
             : std::accumulate(values_.begin(), values_.begin() + static_cast<std::ptrdiff_t>(count_), 0.0F) /
                   static_cast<float>(count_);
}

float Window::quantile(float p) const {
  if (count_ == 0) {
    return 0;
  }
  std::array<float, kLength> sorted = values_;
  return maths::quantile_of(std::span(sorted).first(count_), static_cast<double>(p));
}

void MovingFigures::add(const mesh::MeshFrame& frame, Clock::time_point handed_out) {
  if (!frame.displacements_mm.empty()) {
    photometric_rms_.add(frame.photometric_rms);
  }
  add(frame.stage_ms, handed_out);
}

void MovingFigures::add(const mesh::StageTimes& times, Clock::time_point handed_out) {
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    if (const float time_ms = times.*(kStages[s].time_ms); time_ms > 0) {
      stages_[s].add(time_ms);
      histograms_[s].add(time_ms);
    }
  }
  if (last_ != Clock::time_point()) {
    between_s_.add(std::chrono::duration<float>(handed_out - last_).count());
  }
  last_ = handed_out;
}

void MovingFigures::fill(PipelineStatus& status) const {
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    status.stages[s] = {stages_[s].mean(), stages_[s].quantile(0.95F)};
  }
  status.histograms = histograms_;
  const float between_s = between_s_.mean();
  status.frames_per_second = between_s > 0 ? 1.0 / static_cast<double>(between_s) : 0.0;
  status.photometric_rms = photometric_rms_.mean();
}

}  // namespace facet::pipeline
