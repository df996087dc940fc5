#include "refine/step_planner.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <utility>

namespace facet::refine {
namespace {

constexpr int kColdSteps = 3;
// Of a level's work, in PCG iterations: what a step costs beside them, and what a level costs without a step.
constexpr double kStepWork = 3.7;
constexpr double kLevelWork = 2.5;
// Weight of a new frame in the smoothed times.
constexpr double kNews = 0.2;
// A frame counts as at most this many times slower than the last ones.
constexpr double kSpike = 4;
// A richer plan must be predicted to leave this share of the limit.
constexpr double kRoom = 0.15;

}  // namespace

StepPlanner::StepPlanner(std::vector<std::uint32_t> vertex_counts)
    : vertex_counts_(std::move(vertex_counts)), wanted_(vertex_counts_.size(), 1) {}

/// Rung 0: the steps that pay; 1: one step; 2: of fewer iterations; from 3 on one more level is interpolated.
StepPlan StepPlanner::plan_of(int rung) const {
  StepPlan plan;
  plan.steps = wanted_;
  if (rung >= 1) {
    std::fill(plan.steps.begin(), plan.steps.end(), 1);
  }
  plan.pcg_iterations = rung >= 2 ? kFewPcgIterations : kPcgIterations;
  for (int dropped = 0; dropped < rung - 2; ++dropped) {
    plan.steps[plan.steps.size() - 1 - static_cast<std::size_t>(dropped)] = 0;
  }
  return plan;
}

double StepPlanner::work(const StepPlan& plan) const {
  double sum = 0;
  for (std::size_t l = 0; l < plan.steps.size(); ++l) {
    sum += static_cast<double>(vertex_counts_[l]) *
           (kLevelWork + plan.steps[l] * (kStepWork + static_cast<double>(plan.pcg_iterations)));
  }
  return sum;
}

double StepPlanner::predicted_ms(int rung) const {
  return other_ms_ + ms_per_work_ * work(plan_of(rung));
}

void StepPlanner::choose_rung(float time_limit_ms) {
  limit_ms_ = time_limit_ms;
  if (time_limit_ms <= 0) {
    rung_ = 0;
    calm_frames_ = 0;
    return;
  }
  if (ms_per_work_ <= 0) {
    return;  // nothing is known yet
  }
  const auto limit = static_cast<double>(time_limit_ms);
  if (rung_ < last_rung() && predicted_ms(rung_) > limit) {
    while (rung_ < last_rung() && predicted_ms(rung_) > limit) {
      ++rung_;
    }
    calm_frames_ = 0;
    return;
  }
  const bool room = rung_ > 0 && predicted_ms(rung_ - 1) <= (1 - kRoom) * limit;
  calm_frames_ = room ? calm_frames_ + 1 : 0;
  if (calm_frames_ >= kPatience) {
    --rung_;
    calm_frames_ = 0;
  }
}

/// One step more on every level, and what it brought.
StepPlan StepPlanner::probe_of(StepPlan plan) const {
  plan.last_energy = true;
  for (int& steps : plan.steps) {
    ++steps;
  }
  return plan;
}

StepPlan StepPlanner::cold_start_of(StepPlan plan) const {
  for (int& steps : plan.steps) {
    steps = steps > 0 && rung_ == 0 ? std::max(steps, kColdSteps) : steps;
  }
  return plan;
}

StepPlan StepPlanner::next(bool warm, float time_limit_ms) {
  const std::pair before(rung_, limit_ms_ > 0);
  choose_rung(time_limit_ms);
  changes_ += std::pair(rung_, limit_ms_ > 0) == before ? 0 : 1;
  plan_ = plan_of(rung_);
  cold_ = !warm;
  if (cold_) {
    plan_ = cold_start_of(plan_);
  } else if (rung_ == 0 && frames_ % kProbeEvery == kProbeEvery - 1) {
    plan_ = probe_of(plan_);
  }
  ++frames_;
  return plan_;
}

std::vector<StepPlan> StepPlanner::coming() const {
  const StepPlan plan = plan_of(rung_);
  std::vector<StepPlan> plans{plan};
  if (rung_ == 0) {
    plans.push_back(probe_of(plan));
  } else {
    plans.push_back(plan_of(rung_ - 1));
  }
  if (limit_ms_ > 0 && rung_ < last_rung()) {
    plans.push_back(plan_of(rung_ + 1));
  }
  plans.push_back(cold_start_of(plan));
  return plans;
}

void StepPlanner::postpone(const StepPlan& instead) {
  plan_ = instead;
  --frames_;
}

void StepPlanner::learn(const std::vector<std::vector<double>>& energies, float displacement_ms,
                        float frame_ms) {
  const double per_work = static_cast<double>(displacement_ms) / work(plan_);
  const double other = std::max(0.0, static_cast<double>(frame_ms - displacement_ms));
  if (cold_) {
    // A first frame's times are those of compiling and of a whole picture.
  } else if (ms_per_work_ <= 0) {
    ms_per_work_ = per_work;
    other_ms_ = other;
  } else {
    ms_per_work_ += kNews * (std::min(per_work, kSpike * ms_per_work_) - ms_per_work_);
    other_ms_ += kNews * (std::min(other, kSpike * other_ms_) - other_ms_);
  }
  if (!plan_.last_energy) {
    return;
  }
  const std::vector<int> wanted_before = wanted_;
  for (std::size_t l = 0; l < energies.size(); ++l) {
    // Energies before each step and after the last; the last step is the probe.
    const std::vector<double>& level = energies[l];
    if (level.size() < 3) {
      continue;
    }
    const double after = level.back();
    const double by_probe = level[level.size() - 2] - after;
    const double by_last = level[level.size() - 3] - level[level.size() - 2];
    if (by_probe > kWorthwhile * after) {
      wanted_[l] = std::min(wanted_[l] + 1, kMostSteps - 1);
    } else if (by_last < kWorthwhile * after) {
      wanted_[l] = std::max(wanted_[l] - 1, 1);
    }
  }
  changes_ += wanted_ == wanted_before ? 0 : 1;
}

std::string StepPlanner::given_up() const {
  if (rung_ == 0) {
    return "";
  }
  std::string what = rung_ == 1 ? "one solver step on every level" : "one short solver step on every level";
  const int dropped = rung_ - 2;
  if (dropped > 0) {
    const auto levels = static_cast<int>(vertex_counts_.size());
    what = dropped == 1 ? fmt::format("level {} is interpolated", levels - 1)
                        : fmt::format("levels {} to {} are interpolated", levels - dropped, levels - 1);
  }
  return fmt::format("{}, to stay within {:.0f} ms a frame", what, static_cast<double>(limit_ms_));
}

}  // namespace facet::refine
