#include "ceres_solver.hpp"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>

namespace facet::bench {
namespace {

using Lighting = Eigen::Matrix<double, 9, 1>;

/// The three data residuals of an inner vertex, sqrt(weight) (I - R), over the displacements of its ring.
/// They do not depend on its own: the ring's vector area, which is n* of [MD19 eq. 5], does not.
class DataCost : public ceres::CostFunction {
 public:
  DataCost(const SolverProblem& problem, std::size_t vertex)
      : root_(std::sqrt(static_cast<double>(problem.problem.data_weight[vertex] * problem.problem.gain))),
        colour_(problem.problem.colours.col(static_cast<Eigen::Index>(vertex)).cast<double>()),
        albedo_(problem.problem.albedo.col(static_cast<Eigen::Index>(vertex)).cast<double>()),
        lighting_(
            Eigen::Map<const Eigen::Matrix<float, 9, 1>>(problem.problem.lighting.data()).cast<double>()) {
    const mesh::OneRings& rings = problem.rings;
    for (std::int32_t k = rings.offsets[vertex]; k < rings.offsets[vertex + 1]; ++k) {
      const Eigen::Index index = rings.neighbours[static_cast<std::size_t>(k)];
      positions_.emplace_back(problem.problem.vertices_mm.col(index).cast<double>());
      normals_.emplace_back(problem.problem.normals.col(index).cast<double>());
      mutable_parameter_block_sizes()->push_back(1);
    }
    set_num_residuals(3);
  }

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    constexpr std::size_t largest_ring = 16;
    std::array<Eigen::Vector3d, largest_ring> displaced;
    const std::size_t size = positions_.size();
    for (std::size_t k = 0; k < size; ++k) {
      displaced[k] = positions_[k] + parameters[k][0] * normals_[k];
    }
    Eigen::Vector3d star = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < size; ++k) {
      star += displaced[k].cross(displaced[(k + 1) % size]);
    }
    const double length = star.norm();
    const Eigen::Vector3d n = star / length;
    Lighting basis;
    basis << 1, n.x(), n.y(), n.z(), n.x() * n.y(), n.x() * n.z(), n.y() * n.z(),
        n.x() * n.x() - n.y() * n.y(), 3 * n.z() * n.z() - 1;
    Eigen::Map<Eigen::Vector3d>{residuals} = root_ * (colour_ - lighting_.dot(basis) * albedo_);
    if (jacobians == nullptr) {
      return true;
    }
    const Lighting& l = lighting_;
    const Eigen::Vector3d gradient(l[1] + l[4] * n.y() + l[5] * n.z() + 2 * l[7] * n.x(),
                                   l[2] + l[4] * n.x() + l[6] * n.z() - 2 * l[7] * n.y(),
                                   l[3] + l[5] * n.x() + l[6] * n.y() + 6 * l[8] * n.z());
    const Eigen::Vector3d slope = (gradient - n.dot(gradient) * n) / length;
    for (std::size_t k = 0; k < size; ++k) {
      if (jacobians[k] != nullptr) {
        const Eigen::Vector3d change =
            normals_[k].cross(displaced[(k + 1) % size] - displaced[(k + size - 1) % size]);
        Eigen::Map<Eigen::Vector3d>{jacobians[k]} = -root_ * slope.dot(change) * albedo_;
      }
    }
    return true;
  }

 private:
  double root_;
  Eigen::Vector3d colour_;
  Eigen::Vector3d albedo_;
  Lighting lighting_;
  std::vector<Eigen::Vector3d> positions_;
  std::vector<Eigen::Vector3d> normals_;
};

/// scale (d_i - mean of d over the ring): own displacement first.
class BendCost : public ceres::CostFunction {
 public:
  BendCost(double scale, int ring_size) : scale_(scale), ring_size_(ring_size) {
    mutable_parameter_block_sizes()->assign(static_cast<std::size_t>(ring_size) + 1, 1);
    set_num_residuals(1);
  }

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    double mean = 0;
    for (int k = 1; k <= ring_size_; ++k) {
      mean += parameters[k][0] / ring_size_;
    }
    residuals[0] = scale_ * (parameters[0][0] - mean);
    for (int k = 0; jacobians != nullptr && k <= ring_size_; ++k) {
      if (jacobians[k] != nullptr) {
        jacobians[k][0] = k == 0 ? scale_ : -scale_ / ring_size_;
      }
    }
    return true;
  }

 private:
  double scale_;
  int ring_size_;
};

/// The hierarchy and the coarse term of one vertex.
class PriorCost : public ceres::SizedCostFunction<2, 1> {
 public:
  PriorCost(double prolonged_mm, double hierarchy_scale, double coarse_scale)
      : prolonged_mm_(prolonged_mm), hierarchy_scale_(hierarchy_scale), coarse_scale_(coarse_scale) {}

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    residuals[0] = hierarchy_scale_ * (parameters[0][0] - prolonged_mm_);
    residuals[1] = coarse_scale_ * parameters[0][0];
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      jacobians[0][0] = hierarchy_scale_;
      jacobians[0][1] = coarse_scale_;
    }
    return true;
  }

 private:
  double prolonged_mm_;
  double hierarchy_scale_;
  double coarse_scale_;
};

void add_terms(const SolverProblem& problem, std::vector<double>& displacements_mm, ceres::Problem& out) {
  const refine::DisplacementOptions& options = problem.options;
  for (double& displacement_mm : displacements_mm) {
    out.AddParameterBlock(&displacement_mm, 1);
  }
  for (std::size_t v = 0; v < problem.vertex_count(); ++v) {
    std::vector<double*> ring;
    for (std::int32_t k = problem.rings.offsets[v]; k < problem.rings.offsets[v + 1]; ++k) {
      ring.push_back(
          &displacements_mm[static_cast<std::size_t>(problem.rings.neighbours[static_cast<std::size_t>(k)])]);
    }
    if (problem.problem.data_weight[v] > 0) {
      out.AddResidualBlock(new DataCost(problem, v), nullptr, ring);
    }
    const auto spacing = static_cast<double>(problem.spacing_mm[v]);
    std::vector<double*> own_and_ring{&displacements_mm[v]};
    own_and_ring.insert(own_and_ring.end(), ring.begin(), ring.end());
    out.AddResidualBlock(new BendCost(std::sqrt(static_cast<double>(options.smooth_weight)) / spacing,
                                      static_cast<int>(ring.size())),
                         nullptr, own_and_ring);
    out.AddResidualBlock(new PriorCost(static_cast<double>(problem.problem.prolonged_mm[v]),
                                       std::sqrt(static_cast<double>(options.hierarchy_weight)) / spacing,
                                       std::sqrt(static_cast<double>(options.coarse_weight))),
                         nullptr, &displacements_mm[v]);
    if (problem.problem.fixed[v] != 0) {
      out.SetParameterBlockConstant(&displacements_mm[v]);
    }
  }
}

}  // namespace

CeresResult solve_with_ceres(const SolverProblem& problem, int steps, int pcg_iterations, int threads) {
  std::vector<double> displacements_mm(problem.problem.start_mm.begin(), problem.problem.start_mm.end());
  ceres::Problem ceres_problem;
  add_terms(problem, displacements_mm, ceres_problem);

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::CGNR;
  options.preconditioner_type = ceres::JACOBI;
  options.num_threads = threads;
  options.max_num_iterations = steps;
  options.initial_trust_region_radius = 1e16;  // Levenberg-Marquardt's damping off: plain Gauss-Newton
  options.logging_type = ceres::SILENT;
  if (pcg_iterations > 0) {
    options.min_linear_solver_iterations = pcg_iterations;
    options.max_linear_solver_iterations = pcg_iterations;
    options.function_tolerance = 0;
    options.gradient_tolerance = 0;
    options.parameter_tolerance = 0;
  }
  ceres::Solver::Summary summary;
  ceres::Solve(options, &ceres_problem, &summary);

  CeresResult result;
  result.displacements_mm.assign(displacements_mm.begin(), displacements_mm.end());
  double seconds = 0;
  for (const ceres::IterationSummary& iteration : summary.iterations) {
    if (iteration.iteration > 0) {  // the first is the evaluation of the start
      seconds += iteration.iteration_time_in_seconds;
      ++result.steps;
    }
  }
  constexpr double ms_per_s = 1e3;
  result.step_ms = result.steps > 0 ? ms_per_s * seconds / result.steps : 0;
  return result;
}

}  // namespace facet::bench
