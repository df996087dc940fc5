#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "capture/rig.hpp"

namespace facet::capture {

/// The same point of a surface in the pictures of a pair, px of the pictures as they were taken.
struct PointMatch {
  Eigen::Vector2d left_px;
  Eigen::Vector2d right_px;
};

/// How far a match misses the epipolar geometry of two lenses: Sampson's distance [Sam82] on
/// directions with the distortion undone, times the mean focal length, so about px in each picture; signed.
/// Nothing where the distortion can't be undone. 0 for two cameras in one place, where any two points may
/// match.
std::optional<double> epipolar_error_px(const Lens& left, const Lens& right, const PointMatch& match);

/// Where the two lines of sight of a match come closest (the middle), rig frame, mm; nothing where they meet
/// behind a camera or not at all.
std::optional<Eigen::Vector3d> triangulate_mm(const Lens& left, const Lens& right, const PointMatch& match);

enum class PairVerdict {
  Fine,
  TooFewMatches,  ///< nothing can be said
  Swapped,        ///< the pictures fit the pair the other way round
  Misaligned,     ///< the pictures do not fit the calibration: a camera was moved, or the rig file is another
                  ///< rig's
};

struct PairCheck {
  PairVerdict verdict = PairVerdict::TooFewMatches;
  std::size_t matches = 0;  ///< with an epipolar error
  double median_px = 0;     ///< of the absolute epipolar errors
  double p95_px = 0;
  double part_in_front = 0;  ///< of the matches whose lines of sight meet in front of both cameras, 0 to 1
  std::string message;       ///< one sentence with the numbers
};

struct PairCheckOptions {
  std::size_t least_matches = 30;
  double most_median_px = 0.7;  ///< several times what calibration and matching leave
};

/// Whether matched points agree with the calibration of a pair. Up to nearly half of the matches may be
/// wrong. Says `Swapped` where the two pictures belong to one another's camera: seen by the epipolar error
/// or, for parallel cameras, by points that lie behind them. `left` and `right` are names for the message.
PairCheck check_pair(const RigCamera& left, const RigCamera& right, std::span<const PointMatch> matches,
                     const PairCheckOptions& options = {});

}  // namespace facet::capture
