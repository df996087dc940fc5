#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace facet::refine {

enum class Budget {
  Auto,   ///< as many steps as lower the energy, as few levels as the time limit asks for
  Fixed,  ///< the same number of Gauss-Newton steps on every level of every frame
  Paper,  ///< 10 Gauss-Newton steps of 7 PCG iterations on every level
};

/// How a frame's displacements are solved.
struct StepPlan {
  /// [level] Gauss-Newton steps, coarsest level first. 0: the level takes the coarser one's displacements,
  /// interpolated.
  std::vector<int> steps;
  int pcg_iterations = 7;
  bool last_energy = false;  ///< the energy after the last step is found as well

  bool operator==(const StepPlan&) const = default;
};

/// Spends a frame's Gauss-Newton steps where they pay (Budget::Auto). Every frame goes on from the one
/// before, so one step keeps a level at its minimum as long as the face moves calmly. Now and then a frame
/// makes one step more and looks what the last ones brought: a level whose last step still lowered its energy
/// by more than kWorthwhile gets it from then on. Under a time limit the plan is thinned out, in this order:
/// extra steps, PCG iterations, the finest level, the next finer, until the frame's predicted time fits; it
/// comes back when a richer plan has fitted with room to spare for kPatience frames. Not thread-safe.
class StepPlanner {
 public:
  static constexpr int kMostSteps = 4;              ///< on one level of one frame
  static constexpr double kWorthwhile = 0.005;      ///< share of a level's energy that a step must bring
  static constexpr std::uint64_t kProbeEvery = 12;  ///< frames from one probe to the next
  static constexpr int kPatience = 30;              ///< frames before a richer plan is tried
  static constexpr int kPcgIterations = 7;
  static constexpr int kFewPcgIterations = 4;

  /// vertex_counts: of the levels, coarsest first.
  explicit StepPlanner(std::vector<std::uint32_t> vertex_counts);

  /// The next frame's plan.
  /// warm           the frame goes on from the previous one's displacements
  /// time_limit_ms  for the whole frame, displacements and all the rest; 0: none
  StepPlan next(bool warm, float time_limit_ms);

  /// What the frame of the last plan came to.
  /// energies         [level][step] before each step, and after the last where the plan asked for it
  /// displacement_ms  of the displacement stage
  /// frame_ms         from submission to result
  void learn(const std::vector<std::vector<double>>& energies, float displacement_ms, float frame_ms);

  /// The plans that the next frames may have, the likeliest first; not those that a probe's outcome leads to.
  std::vector<StepPlan> coming() const;
  /// Another number wherever coming() would say something else than before.
  std::uint64_t changes() const { return changes_; }

  /// Whether the last plan is wanted for its energy alone, so that the frame can do without it.
  bool can_wait() const { return rung_ == 0 && !cold_; }
  /// The frame does without it: it has this plan. The one that can wait comes again.
  void postpone(const StepPlan& instead);

  /// How far the last plan is thinned out: 0 not at all.
  int rung() const { return rung_; }

  /// What the time limit took, for people; empty where nothing.
  std::string given_up() const;

 private:
  int last_rung() const { return 1 + static_cast<int>(vertex_counts_.size()); }
  StepPlan plan_of(int rung) const;
  StepPlan probe_of(StepPlan plan) const;
  StepPlan cold_start_of(StepPlan plan) const;
  double work(const StepPlan& plan) const;
  double predicted_ms(int rung) const;
  void choose_rung(float time_limit_ms);

  std::vector<std::uint32_t> vertex_counts_;
  std::vector<int> wanted_;  ///< [level] steps that pay
  StepPlan plan_;
  std::uint64_t frames_ = 0;
  std::uint64_t changes_ = 0;
  bool cold_ = true;  ///< the last plan was a cold start's
  int rung_ = 0;
  int calm_frames_ = 0;     ///< for which a richer plan would have fitted
  double ms_per_work_ = 0;  ///< smoothed over frames; 0: not known yet
  double other_ms_ = 0;     ///< smoothed: of a frame, beside the displacement stage
  float limit_ms_ = 0;
};

}  // namespace facet::refine
