#pragma once

#include <Eigen/Core>

namespace facet::light {

/// How many directions the sphere is divided into: 16 degrees from one to the next.
constexpr int kRoomDirections = 162;

/// Unit directions spread evenly over the sphere (a Fibonacci lattice), [3][kRoomDirections]. Of whichever
/// frame one wants.
const Eigen::Matrix3Xf& room_directions();

/// [kRoomDirections][kRoomDirections] that takes the strengths of lamps in room_directions() of one frame to
/// those of another: each is shared out among the directions about its own by a bell, half as high 8 degrees
/// away; columns sum to 1.
///
/// to_from_from  rotation
Eigen::MatrixXd turned_lamps(const Eigen::Matrix3f& to_from_from);

/// Of a room: in each direction a lamp far away, then in each one kNearMm from the head's middle.
constexpr int kLamps = 2 * kRoomDirections;
constexpr float kNearMm = 500;

/// Strengths [kLamps] in another frame. to_from_from  turned_lamps()
Eigen::VectorXd turned(const Eigen::MatrixXd& to_from_from, const Eigen::VectorXd& lamps);

/// What a near lamp in direction w gives a place x against the head's middle: (r / |r w - x|)^2, as if the
/// place were never nearer than 100 mm to it.
///
/// along   w . x, mm
/// square  |x|^2, mm^2
float falloff(float along, float square);

/// max(0, c), rounded off where |c| < 0.1 (lamps have a size, and a vertex stands for skin that bends), and
/// its derivative.
struct Clamped {
  float value;
  float slope;
};
Clamped clamped(float cosine);

/// min |A x - b|^2 + ridge |x|^2 with x >= 0: coordinate descent from x on.
///
/// matrix, right  A^T A [n][n] and A^T b [n]
/// ridge          relative to the mean of the diagonal
void descend(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right, double ridge, int sweeps,
             Eigen::VectorXd& x);

}  // namespace facet::light
