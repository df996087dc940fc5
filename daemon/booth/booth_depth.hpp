#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "capture/slot_program.hpp"
#include "facet/frame_set.hpp"
#include "gpu/context.hpp"
#include "stereo/fringe_matcher.hpp"
#include "stereo/rectification.hpp"
#include "stereo/spacetime_solver.hpp"

namespace facet::booth {

/// Slots before and after a blank one that its depth is seen in (docs/stereo.md: the windows' reach in time).
inline constexpr std::size_t kDepthReach = 2;

/// Where the cameras of the pairs look: the point that comes closest to all their axes, 150 mm before and
/// 250 mm behind it as each pair sees it. Throws Error(Usage) where the axes meet nowhere in front of them.
stereo::DepthRange depth_range(const capture::Rig& rig);

/// Why blank slots of a program with fringes get no depth, for people; empty where they do: by stripes within
/// kDepthReach, or by fringes there whose shifts tell a phase.
std::string why_no_depth(const capture::SlotProgram& program);

/// One slot of a run.
struct DepthSlot {
  /// Frames in the rig's order of cameras; null where the slot is missing. Kept alive by the caller.
  const FrameSet* set = nullptr;
  bool has_pattern = true;
  bool wanted = false;                                    ///< a depth map is asked for
  std::optional<stereo::Fringes> fringes = std::nullopt;  ///< as in stereo::StereoSlot
};

/// Where depth maps come from. One thread at a time.
class DepthSource {
 public:
  DepthSource() = default;
  DepthSource(const DepthSource&) = delete;
  DepthSource& operator=(const DepthSource&) = delete;
  virtual ~DepthSource() = default;

  /// Between which depths are found.
  virtual const stereo::DepthRange& depths() const = 0;
  /// For people; empty while the device is lost.
  virtual std::string device() const = 0;
  /// What is wrong with the kernels kept from the start before (gpu::KernelCacheState::ignored); else empty.
  virtual std::string kernels_ignored() const { return {}; }

  /// slots   a run of consecutive ones; first_slot: the number of its first
  /// maps    out, [wanted slots][pairs]; all holes, or empty, where a camera or the device is missing
  /// alive   called between pieces of work and while it waits
  /// Returns what is wrong, for people; empty where all is well.
  virtual std::string find(std::uint64_t first_slot, std::span<const DepthSlot> slots,
                           std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) = 0;
};

/// Depth maps of a rig's pairs on the GPU. Opens the device again where it was lost.
class BoothDepth final : public DepthSource {
 public:
  /// Where a run overlaps the one before, the start values of the slots in both can be taken over. They have
  /// seen other neighbours then, so that what is found depends on the runs before: live, not for recordings.
  enum class Starts { Found, KeptOfTheRunBefore };

  /// depths: 0 to 0 for depth_range. most_slots: of a run. Throws Error: Usage for a rig that stereo refuses,
  /// NoDevice.
  BoothDepth(const std::string& gpu_device, std::shared_ptr<const capture::Rig> rig,
             stereo::DepthRange depths, int most_slots, Starts starts = Starts::Found);
  ~BoothDepth() override;

  const stereo::DepthRange& depths() const override;
  std::string device() const override;
  std::string kernels_ignored() const override;
  std::string find(std::uint64_t first_slot, std::span<const DepthSlot> slots,
                   std::vector<std::vector<capture::DepthMap>>& maps, const stereo::Alive& alive) override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::booth
