#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "stereo/spacetime_solver.hpp"

/// Spacetime stereo [SF04 eq. 5-9] in slow, obvious double precision: every window visits
/// every one of its samples, gain and bias are columns of a least squares problem, the field's slopes are a
/// dense matrix. The GPU is checked against it.
namespace facet::stereo::reference {

struct Volume {
  VolumeSize size;
  std::vector<float> left, right;  ///< [slots][height][width] grey, below 0: nothing
  std::vector<float> start_px;     ///< [slots][height][width] NaN: none
};

/// One window's part of the energy around the field.
struct Window {
  bool speaks = false;
  Eigen::Matrix4d hessian = Eigen::Matrix4d::Zero();
  Eigen::Vector4d gradient = Eigen::Vector4d::Zero();
  double energy = 0;
};

/// (d, dx, dy, dt) of the field at a voxel, [4][voxels] as rows of a matrix: [I; Gx; Gy; Gt].
Eigen::MatrixXd slope_matrix(const Volume& volume, float break_px, std::size_t voxel);

Window window_at(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options, int x,
                 int y, int slot);

/// The update of one Gauss-Newton step over the whole volume, solved directly; not held within a bound. 0
/// where there is no unknown.
Eigen::VectorXd step(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options);

/// Sum of the windows' energies.
double energy(const Volume& volume, const Eigen::VectorXd& field, const SpacetimeOptions& options);

}  // namespace facet::stereo::reference
