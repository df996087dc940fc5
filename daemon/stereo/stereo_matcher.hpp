#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "gpu/context.hpp"
#include "stereo/fringe_matcher.hpp"
#include "stereo/rectification.hpp"
#include "stereo/spacetime_solver.hpp"
#include "stereo/start_value.hpp"

namespace facet::stereo {

/// The pictures of a pair in one trigger slot.
struct StereoSlot {
  Frame left;   ///< of the left camera's size; empty where it is missing: the slots beside it speak for it
  Frame right;  ///< the same of the right camera
  bool has_pattern = true;  ///< false in a blank slot: its depth comes from the slots beside it
  /// [height][width] of the rectified left picture: 0 where no depth is wanted; empty: everywhere.
  std::span<const std::uint8_t> mask = {};
  bool wanted = true;  ///< false: it only speaks for the slots beside it
  /// Of the slot in its recording. Where a slot of the run before has the same, its start value is taken
  /// over; nothing: found anew.
  std::optional<std::uint64_t> number = std::nullopt;
  /// What there was of fringes, which repeat; nothing: another light.
  std::optional<Fringes> fringes = std::nullopt;
};

struct StereoOptions {
  DepthRange depths{600, 900};
  int width_px = 0;  ///< of the depth maps; 0: as the left camera's pictures
  int height_px = 0;
  int most_slots = 9;  ///< that a call may give
  StartOptions start;
  SpacetimeOptions spacetime;
  FringeOptions fringes;
  float least_correlation = 0.7F;  ///< of the pictures over a window
  float most_sigma_mm = 0.5F;      ///< standard deviation of a depth
  int least_island_px = 200;       ///< smaller pieces of surface are noise
  float saturated = 250.5F / 255;  ///< grey value, as coded, from which on a pixel says nothing
};

/// What a match took, ms.
struct StereoTimes {
  float rectify_ms = 0;
  float start_ms = 0;
  float solve_ms = 0;
  float finish_ms = 0;
};

/// On how many threads a match works: as many as there are processors and slots, 16 at most, and where each
/// finds start values in start_bytes of memory (StartValue::bytes) as many as fit into 1 GiB; at least one.
int thread_count(unsigned processors, int slots, std::size_t start_bytes);

/// From the pictures of a pair to depth maps. One thread at a time; the context must outlive it. `match` has
/// slots worked on by threads of its own while it lasts (thread_count); where one can't be made, those that
/// are there take longer.
class StereoMatcher {
 public:
  /// Sets up all memory and kernels. Throws Error(Usage) for what Rectification, StartValue and
  /// SpacetimeSolver refuse, Error(NoDevice).
  StereoMatcher(gpu::Context& context, const capture::Rig& rig, const capture::StereoPair& pair,
                const StereoOptions& options);
  ~StereoMatcher();

  const Rectification& rectification() const;

  /// Depth of every slot of a run of consecutive ones. Slots near the ends have fewer neighbours in their
  /// windows; those with window_t / 2 slots on either side are as good as they get. Where fringes tell
  /// phases, what stereo found is moved to these (FringeMatcher).
  ///
  /// slots   1 to most_slots
  ///
  /// maps    out, [slots], empty of depths where not wanted; confidence 1 / (1 + (sigma / 0.1 mm)^2) where
  /// there is a depth; a picture of another size than its lens's counts as missing
  ///
  /// alive   called on this thread between pieces of work and while it waits for the device
  ///
  /// DeviceLost and NumericalFailure leave the maps empty of depths; failure() says more. Throws Error(Usage)
  /// for other slots or masks, what `alive` throws, and std::bad_alloc; the next match begins anew.
  StereoOutcome match(
      std::span<const StereoSlot> slots, std::vector<capture::DepthMap>& maps, const Alive& alive = [] {});

  const std::string& failure() const;
  /// Of the last match, for all its slots together.
  const StereoTimes& times() const;
  /// Of its solve, on the device (SpacetimeSolver::stage_times).
  std::span<const gpu::StageTime> stage_times() const;
  /// Of the last match, both submissions.
  std::size_t dispatch_count() const;

  /// Of the last match, over most_slots slots: rectified pictures, grey 0 to 1, below 0 where there is
  /// nothing to see; start values and disparities, px. For pictures and checks.
  std::span<const float> left_grey() const;
  std::span<const float> right_grey() const;
  std::span<const float> start_px() const;
  const DisparityField& field() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::stereo
