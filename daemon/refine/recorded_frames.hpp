#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "gpu/batch.hpp"
#include "refine/step_planner.hpp"

namespace facet::refine {

/// A frame's work, recorded.
struct RecordedFrame {
  StepPlan plan;
  bool learn;  ///< with the albedo
  std::unique_ptr<gpu::Batch> batch;
};

/// The recorded frames of one subject and the plans they follow. Recording takes the host longer than a fast
/// device a frame: what may come next is recorded behind a submitted frame, one a frame, while the device is
/// at work. Not thread-safe.
class RecordedFrames {
 public:
  /// Records a frame; throws as gpu::Batch does.
  using Record = std::function<std::unique_ptr<gpu::Batch>(const StepPlan& plan, bool learn)>;

  /// vertex_counts  of the levels, coarsest first
  /// constant       the plan of every frame; none: a StepPlanner plans them
  /// energies       every frame finds the energy after its last step
  RecordedFrames(const std::vector<std::uint32_t>& vertex_counts, std::optional<StepPlan> constant,
                 bool energies);

  /// The next frame. One that is not recorded yet is recorded now, or where it is wanted for its energy
  /// alone, waits for record_ahead; until then another takes its place. Stays valid until the next but one.
  const RecordedFrame& next(bool warm, bool learn, float time_limit_ms, const Record& record);

  /// Records one of the frames that may come next, where one is not recorded yet.
  /// learn      whether the albedo learns in the next frame
  /// may_learn  whether it learns at all
  void record_ahead(bool learn, bool may_learn, const Record& record);

  /// Forgets what is recorded: something that it uses is another.
  void clear();

  StepPlanner& planner() { return planner_; }
  /// Of the host, ms: how long `next` recorded last; 0 where it had not to.
  float recording_ms() const { return recording_ms_; }

 private:
  const RecordedFrame* find(const StepPlan& plan, bool learn) const;
  const RecordedFrame& add(const StepPlan& plan, bool learn, const Record& record);
  const RecordedFrame& take(const RecordedFrame& frame);

  StepPlanner planner_;
  std::optional<StepPlan> constant_;
  bool energies_;
  StepPlan calm_plan_;                           ///< the last that was no probe
  std::optional<std::uint64_t> recorded_ahead_;  ///< StepPlanner::changes() for which all is recorded
  float recording_ms_ = 0;
  std::vector<std::unique_ptr<RecordedFrame>> frames_;  ///< the last used at the end
};

}  // namespace facet::refine
