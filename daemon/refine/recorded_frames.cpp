#include "refine/recorded_frames.hpp"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::refine {
namespace {

// The plans that Budget::Auto goes back and forth between, with and without the albedo.
constexpr std::size_t kMostRecorded = 12;

}  // namespace

RecordedFrames::RecordedFrames(const std::vector<std::uint32_t>& vertex_counts,
                               std::optional<StepPlan> constant, bool energies)
    : planner_(vertex_counts), constant_(std::move(constant)), energies_(energies) {}

void RecordedFrames::clear() {
  frames_.clear();
  recorded_ahead_.reset();
}

const RecordedFrame* RecordedFrames::find(const StepPlan& plan, bool learn) const {
  const auto found = std::find_if(frames_.begin(), frames_.end(), [&](const auto& frame) {
    return frame->learn == learn && frame->plan == plan;
  });
  return found == frames_.end() ? nullptr : found->get();
}

const RecordedFrame& RecordedFrames::add(const StepPlan& plan, bool learn, const Record& record) {
  auto frame = std::make_unique<RecordedFrame>(RecordedFrame{plan, learn, record(plan, learn)});
  if (frames_.size() >= kMostRecorded) {
    frames_.erase(frames_.begin());  // never the one in flight, which was used last
  }
  // Behind those that were used, before the one in flight.
  const auto place = frames_.empty() ? frames_.end() : frames_.end() - 1;
  return **frames_.insert(place, std::move(frame));
}

const RecordedFrame& RecordedFrames::take(const RecordedFrame& frame) {
  const auto found =
      std::find_if(frames_.begin(), frames_.end(), [&](const auto& one) { return one.get() == &frame; });
  std::rotate(found, found + 1, frames_.end());
  return frame;
}

const RecordedFrame& RecordedFrames::next(bool warm, bool learn, float time_limit_ms, const Record& record) {
  recording_ms_ = 0;
  StepPlan plan = constant_ ? *constant_ : planner_.next(warm, time_limit_ms);
  const bool probe = std::exchange(plan.last_energy, plan.last_energy || energies_);
  const RecordedFrame* there = find(plan, learn);
  if (there == nullptr && !constant_ && planner_.can_wait()) {
    if (const RecordedFrame* calm = find(calm_plan_, learn)) {
      planner_.postpone(calm_plan_);
      return take(*calm);
    }
  }
  if (there == nullptr) {
    const Clock::time_point begin = Clock::now();
    there = &add(plan, learn, record);
    recording_ms_ = std::chrono::duration<float, std::milli>(Clock::now() - begin).count();
  }
  if (!probe) {
    calm_plan_ = plan;
  }
  return take(*there);
}

void RecordedFrames::record_ahead(bool learn, bool may_learn, const Record& record) {
  if (recorded_ahead_ == planner_.changes()) {
    return;
  }
  std::vector<StepPlan> coming = constant_ ? std::vector<StepPlan>{*constant_} : planner_.coming();
  try {
    for (const bool learning : {learn, !learn}) {
      for (StepPlan& plan : coming) {
        plan.last_energy = plan.last_energy || energies_;
        if ((may_learn || !learning) && find(plan, learning) == nullptr) {
          add(plan, learning, record);
          return;
        }
      }
    }
  } catch (const Error&) {
    return;  // a frame that needs it tries again and says why
  }
  recorded_ahead_ = planner_.changes();
}

}  // namespace facet::refine
