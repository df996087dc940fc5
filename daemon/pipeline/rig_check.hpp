#pragma once

#include <memory>
#include <string>
#include <vector>

#include "capture/epipolar.hpp"
#include "capture/rig.hpp"
#include "facet/frame_set.hpp"
#include "pipeline/status.hpp"
#include "stereo/rectification.hpp"

namespace facet::pipeline {

/// Points that both cameras of a pair see, found without relying on the calibration to more than a few
/// degrees: corners of the left picture (Shi & Tomasi 1994) looked for in the right one around where their
/// lines of sight lie (normalised correlation, the peak's parabola). For blank slots: stripes look alike
/// along themselves. Empty where a picture is. 0.1 s; any thread.
std::vector<capture::PointMatch> match_corners(const capture::Lens& left, const capture::Lens& right,
                                               const Frame& left_picture, const Frame& right_picture,
                                               const stereo::DepthRange& depths);

/// Looks while a booth runs whether its cameras still stand as they were calibrated. One thread.
class RigCheck {
 public:
  RigCheck(std::shared_ptr<const capture::Rig> rig, const stereo::DepthRange& depths);

  /// A blank slot, frames in the rig's order. Looks at one pair a call, in turn, and judges it once enough
  /// points were gathered; most slots it has been told of before count for nothing. Returns what is wrong
  /// with a pair, for people, as long as it is; empty where all is well or nothing is known yet.
  std::string look(const FrameSet& set);
  /// [pair_count] as the rig has them.
  const std::vector<RigPairStatus>& pairs() const { return known_; }

 private:
  struct Pair {
    std::vector<capture::PointMatch> matches;
    int slots = 0;  ///< that they come from
  };

  void judge(Pair& pair, RigPairStatus& known) const;

  std::shared_ptr<const capture::Rig> rig_;
  stereo::DepthRange depths_;
  std::vector<Pair> pairs_;
  std::vector<RigPairStatus> known_;
  std::size_t next_ = 0;
};

}  // namespace facet::pipeline
