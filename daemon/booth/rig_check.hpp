#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "capture/epipolar.hpp"
#include "capture/rig.hpp"
#include "facet/frame_set.hpp"
#include "stereo/rectification.hpp"

namespace facet::booth {

/// Points that both cameras of a pair see, found where the calibration is right within a degree: corners of
/// the left picture [ST94] looked for in the right one around where their lines of sight lie (normalised
/// correlation, the peak's parabola). For blank slots: a stripe looks the same all along its length. No
/// matches where a picture is empty or damaged, or has another size than its lens. 0.1 s; any thread.
std::vector<capture::PointMatch> match_corners(const capture::Lens& left, const capture::Lens& right,
                                               const Frame& left_picture, const Frame& right_picture,
                                               const stereo::DepthRange& depths);

/// What is known of how two cameras stand to each other, against their calibration.
struct RigPairStatus {
  /// Parts of the left camera's picture, as many across and down.
  static constexpr int kColumns = 8;
  static constexpr int kRows = 6;

  std::string left;  ///< the cameras' names
  std::string right;
  std::size_t matches = 0;  ///< points that the last judgement is from; 0: none yet
  double median_px = 0;     ///< of their epipolar errors (capture::epipolar_error_px), absolute
  double p95_px = 0;
  std::string wrong;  ///< for people; empty where all is well or nothing is known
  /// Mean absolute error where the left camera saw points, px; matches that miss by far are left out as wrong
  /// ones, unless the pair is judged wrong; below 0: none were seen there. Row by row, from the top left.
  std::array<float, std::size_t{kColumns} * kRows> error_px;

  RigPairStatus() { error_px.fill(-1); }
};

/// Looks while a booth runs whether its cameras still stand as they were calibrated. One thread.
class RigCheck {
 public:
  RigCheck(std::shared_ptr<const capture::Rig> rig, const stereo::DepthRange& depths);

  /// Looks at one pair of cameras in the pictures of a blank slot, each call at the next pair in turn. A
  /// pair's points are gathered over several slots, until there are enough of them or the slots are many.
  /// Then the pair is judged by these points, unless they are too few to tell, and gathering begins anew
  /// without them.
  ///
  /// set      [camera_count] frames, in the rig's order
  /// returns  for people, what is wrong with the first pair whose last judgement was bad; empty where there
  ///          is no such pair, and while nothing is known yet
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

}  // namespace facet::booth
