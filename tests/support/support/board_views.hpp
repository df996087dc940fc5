#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "calibration/board.hpp"
#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "simulation/random.hpp"

namespace facet::calibration {

/// A booth as in the paper, every number off by a little that the seed decides: two pairs of monochrome
/// cameras
/// ("left-a", "left-b", "right-a", "right-b"), 60 mm apart, 30 degrees to either side, and two colour cameras
/// ("colour-a", "colour-b"), all 640x480 and about 800 mm from the middle, which is the rig frame's origin; y
/// points down, z away from the cameras.
capture::Rig booth_rig(std::uint64_t seed);

/// Where a board is held before the cameras of booth_rig: rig_from_board, turned to all sides by up to
/// most_tilt_deg and moved about. [count]
std::vector<Eigen::Isometry3d> held_board_poses(const Board& board, int count, std::uint64_t seed,
                                                double most_tilt_deg = 35);

/// The corners of a board that lie in a lens' picture, with noise of this standard deviation in x and in y.
/// No picture is made; the board's own front and back are told apart.
BoardView seen_corners(const Board& board, const capture::Lens& lens, const Eigen::Isometry3d& rig_from_board,
                       double noise_px, simulation::Random& random);

struct BoardPictureOptions {
  double noise = 2;      ///< standard deviation in grey levels
  double blur_px = 0.5;  ///< standard deviation of the lens' blur
};

/// Takes pictures of one board through one lens. One thread.
class BoardCamera {
 public:
  BoardCamera(const Board& board, const capture::Lens& lens);

  /// A monochrome picture before a grey background, antialiased.
  Frame take(const Eigen::Isometry3d& rig_from_board, const BoardPictureOptions& options,
             simulation::Random& random) const;

 private:
  capture::Lens lens_;
  double px_per_mm_;
  double margin_mm_;
  render::Picture sheet_;
  std::vector<Eigen::Vector2f>
      directions_;  // [height][4][width][4] x/z, y/z; NaN where the lens sees nothing
};

}  // namespace facet::calibration
