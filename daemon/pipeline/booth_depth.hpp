#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/depth_map.hpp"
#include "capture/rig.hpp"
#include "facet/frame_set.hpp"
#include "gpu/context.hpp"
#include "stereo/rectification.hpp"
#include "stereo/spacetime_solver.hpp"

namespace facet::pipeline {

/// Slots before and after a blank one that its depth is seen in (docs/stereo.md: the windows' reach in time).
inline constexpr std::size_t kDepthReach = 2;

/// Where the cameras of the pairs look: the point that comes closest to all their axes, 150 mm before and
/// 250 mm behind it as each pair sees it. Throws Error(Usage) where the axes meet nowhere in front of them.
stereo::DepthRange depth_range(const capture::Rig& rig);

/// One slot of a run.
struct DepthSlot {
  /// Frames in the rig's order of cameras; null where the slot is missing. Kept alive by the caller.
  const FrameSet* set = nullptr;
  bool stripes = true;
  bool wanted = false;  ///< a depth map is asked for
};

/// Depth maps of a rig's pairs on the GPU. Opens the device again where it was lost. One thread at a time.
class BoothDepth {
 public:
  /// depths: 0 to 0 for depth_range. most_slots: of a run. Throws Error: Usage for a rig that stereo refuses,
  /// NoDevice.
  BoothDepth(const std::string& gpu_device, std::shared_ptr<const capture::Rig> rig,
             stereo::DepthRange depths, int most_slots);
  ~BoothDepth();

  /// Between which depths are found.
  const stereo::DepthRange& depths() const;
  /// For people; empty while the device is lost.
  std::string device() const;

  /// slots   a run of consecutive ones, at most most_slots
  /// maps    out, [wanted slots][pairs]; all holes where a camera or the device is missing
  /// alive   called between pieces of work and while it waits for the device
  /// Returns what is wrong, for people; empty where all is well.
  std::string find(std::span<const DepthSlot> slots, std::vector<std::vector<capture::DepthMap>>& maps,
                   const stereo::Alive& alive);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::pipeline
