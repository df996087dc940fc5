#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstdint>
#include <string>
#include <vector>

#include "mesh/mesh.hpp"

/// The energies of [MD19 sec. 4] and their solvers in slow, obvious double precision. The GPU is
/// checked against this. Vectors stand in the shading frame: x right, y up, z towards the camera.
namespace facet::refine::reference {

using Lighting = Eigen::Matrix<double, 9, 1>;
/// The 9 coefficients and the factor of the room's irradiance.
using RoomLighting = Eigen::Matrix<double, 10, 1>;
using Matrix39d = Eigen::Matrix<double, 3, 9>;

/// 9 spherical-harmonics values of a unit normal [MD19 eq. 1].
Lighting sh_basis(const Eigen::Vector3d& normal);

/// d SH / d n of the 9 values, [3][9], n taken as three free numbers.
Matrix39d sh_gradient(const Eigen::Vector3d& normal);

/// R = (l . SH(n)) rho [MD19 eq. 1].
Eigen::Vector3d reflected(const Lighting& lighting, const Eigen::Vector3d& normal,
                          const Eigen::Vector3d& albedo);

/// What the room's lamps give a vertex: irradiance[0] + irradiance[1..3] . n.
double lit_by_lamps(const Eigen::Vector4d& irradiance, const Eigen::Vector3d& normal);

/// The displacement problem of one level [MD19 eq. 6]. Columns are vertices.
struct Problem {
  const mesh::OneRings* rings = nullptr;
  Eigen::Matrix3Xd vertices_mm;     ///< coarse mesh of this level
  Eigen::Matrix3Xd normals;         ///< unit coarse normals
  Eigen::VectorXd spacing_mm;       ///< mean distance to the ring
  Eigen::Matrix3Xd colours;         ///< I, linear
  Eigen::Matrix3Xd albedo;          ///< rho, linear
  Eigen::VectorXd data_weight;      ///< 0 where unseen, excluded or on the boundary
  std::vector<std::uint8_t> fixed;  ///< 1: d = 0 (boundary, excluded)
  Lighting lighting = Lighting::Zero();
  Eigen::Matrix4Xd irradiance;   ///< of the room's lamps: row 0 + rows 1 to 3 . n; empty: there are none
  Eigen::VectorXd prolonged_mm;  ///< pd; 0 at fixed vertices
  double smooth_weight = 0;      ///< w3, on (L d)_i / spacing_i
  double hierarchy_weight = 0;   ///< w4, on (pd_i - d_i) / spacing_i
  double coarse_weight = 0;      ///< w5, on d_i in mm
  double robust_scale = 0;       ///< Tukey's bound on |I - R|, weighted; 0: plain squares
  double fold_slope = 0;         ///< bend from which on w3 grows linearly; 0: plain squares

  Eigen::Index vertex_count() const { return vertices_mm.cols(); }
};

/// R of a vertex with a unit normal: [MD19 eq. 1] and what the room's lamps give it.
Eigen::Vector3d reflected(const Problem& problem, const Eigen::Vector3d& normal, Eigen::Index vertex);

/// Mean distance of every vertex to its ring, mm.
Eigen::VectorXd ring_spacing(const mesh::OneRings& rings, const Eigen::Matrix3Xd& vertices_mm);

/// Area-weighted unit normals: [MD19 eq. 5] at d = 0, normalised.
Eigen::Matrix3Xd coarse_normals(const mesh::OneRings& rings, const Eigen::Matrix3Xd& vertices_mm);

/// n*_i of [MD19 eq. 5], not normalised.
Eigen::Vector3d displaced_normal(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                 Eigen::Index vertex);

/// Unit normals of the displaced mesh.
Eigen::Matrix3Xd displaced_normals(const Problem& problem, const Eigen::VectorXd& displacements_mm);

/// (L d)_i = d_i - mean of d over the ring.
double graph_laplacian(const mesh::OneRings& rings, const Eigen::VectorXd& values, Eigen::Index vertex);

/// Tukey's weight of a residual norm: (1 - (r / scale)^2)^2, 0 beyond the scale, 1 where scale is 0.
double tukey_weight(double residual, double scale);

/// Tukey's loss, near r^2 for small r, at most scale^2 / 3; r^2 where scale is 0.
double tukey_loss(double residual, double scale);

/// Charbonnier's weight and loss of a bend: near 1 and bend^2 where it is small, slope / bend and 2 slope
/// bend where it is large.
double fold_weight(double bend, double slope);
double fold_loss(double bend, double slope);

/// Weights in one Gauss-Newton step, [2K]: of the data rows, data_weight times Tukey's weight at d; then of
/// the smoothness rows, w3 times the fold weight at d.
Eigen::VectorXd step_weights(const Problem& problem, const Eigen::VectorXd& displacements_mm);

/// E(d) of [MD19 eq. 6].
double energy(const Problem& problem, const Eigen::VectorXd& displacements_mm);

/// The 6K residuals y - f of [MD19 eq. 7] in the order: data [3 * vertex + channel], smoothness, hierarchy,
/// coarse, each times the root of its weight.
Eigen::VectorXd residuals(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                          const Eigen::VectorXd& weights);

/// d f / d d [MD19 eq. 8], [6K][K]; columns of fixed vertices are empty.
Eigen::SparseMatrix<double> jacobian(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                     const Eigen::VectorXd& weights);

/// What a derivative check found.
struct DerivativeCheck {
  double worst_error = 0;  ///< |analytic - numeric| relative to the largest entry
  std::string where;
};

/// Compares a Jacobian of `residuals` with central differences in every free vertex.
DerivativeCheck check_jacobian(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                               const Eigen::SparseMatrix<double>& jacobian);

/// J^T J delta = J^T r by conjugate gradients with the Jacobi preconditioner, from 0. Fixed vertices stay 0.
Eigen::VectorXd pcg(const Eigen::SparseMatrix<double>& jacobian, const Eigen::VectorXd& residuals,
                    int iterations);

/// One step of [MD19 eq. 8]; pcg_iterations 0: solved exactly.
Eigen::VectorXd gauss_newton_step(const Problem& problem, const Eigen::VectorXd& displacements_mm,
                                  int pcg_iterations);

/// min over l and the factor of what lamps give each vertex of [MD19 eq. 3]: sum of weight_i |I_i - R_i|^2 +
/// temporal_weight |l - previous|^2, and the same of the factor in its own unit.
RoomLighting estimate_lighting(const Eigen::Matrix3Xd& normals, const Eigen::VectorXd& lamps,
                               const Eigen::Matrix3Xd& albedo, const Eigen::Matrix3Xd& colours,
                               const Eigen::VectorXd& weights, double temporal_weight,
                               const RoomLighting& previous);

/// min over rho of [MD19 eq. 4] over several frames: sum of shade_squared_i rho_i^2 - 2 shade_colour_i rho_i
/// + smooth_weight |L rho - L mean|^2, solved exactly.
/// shade_squared [K] sums over frames of w (l . SH)^2; shade_colour [3][K] sums of w (l . SH) I.
Eigen::Matrix3Xd estimate_albedo(const mesh::OneRings& rings, const Eigen::VectorXd& shade_squared,
                                 const Eigen::Matrix3Xd& shade_colour, const Eigen::Matrix3Xd& mean_albedo,
                                 double smooth_weight);

}  // namespace facet::refine::reference
