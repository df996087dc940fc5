#include "support/displacement_solver.hpp"

#include <limits>

#include "facet/error.hpp"
#include "problems.hpp"
#include "support/gpu.hpp"

namespace facet::refine {
namespace {

DisplacementProblem to_gpu(const test::SmallProblem& small) {
  const reference::Problem& from = small.problem;
  DisplacementProblem out;
  out.one_rings = from.rings;
  out.vertices_mm = from.vertices_mm.cast<float>();
  out.normals = from.normals.cast<float>();
  out.colours = from.colours.cast<float>();
  out.albedo = from.albedo.cast<float>();
  out.fixed = from.fixed;
  for (Eigen::Index i = 0; i < from.vertex_count(); ++i) {
    out.data_weight.push_back(static_cast<float>(from.data_weight[i]));
    out.prolonged_mm.push_back(static_cast<float>(from.prolonged_mm[i]));
    out.start_mm.push_back(static_cast<float>(small.start_mm[i]));
  }
  for (int k = 0; k < 9; ++k) {
    out.lighting[static_cast<std::size_t>(k)] = static_cast<float>(from.lighting[k]);
  }
  out.irradiance = from.irradiance.cast<float>();
  return out;
}

DisplacementOptions options_of(const reference::Problem& problem, int steps, int iterations) {
  DisplacementOptions out;
  out.smooth_weight = static_cast<float>(problem.smooth_weight);
  out.hierarchy_weight = static_cast<float>(problem.hierarchy_weight);
  out.coarse_weight = static_cast<float>(problem.coarse_weight);
  out.robust_scale = static_cast<float>(problem.robust_scale);
  out.fold_slope = static_cast<float>(problem.fold_slope);
  out.gauss_newton_steps = steps;
  out.pcg_iterations = iterations;
  return out;
}

Eigen::VectorXd to_vector(const std::vector<float>& values) {
  return Eigen::Map<const Eigen::VectorXf>(values.data(), static_cast<Eigen::Index>(values.size()))
      .cast<double>();
}

using DisplacementSolverTest = facet::test::GpuTest;

struct Shape {
  int columns;
  int rows;
  int level;
};

TEST_F(DisplacementSolverTest, OneStepAgreesWithTheReference) {
  // 2 x 2 quads are 13 vertices, 5 x 11 are 127; the last is a finer, adaptive level.
  for (const Shape shape : {Shape{2, 2, 0}, Shape{5, 11, 0}, Shape{9, 7, 1}}) {
    const test::SmallProblem small = test::make_problem(shape.columns, shape.rows, 41, shape.level);
    SCOPED_TRACE(small.problem.vertex_count());
    DisplacementSolver solver(context());
    solver.load(to_gpu(small), options_of(small.problem, 1, 7));
    const DisplacementResult result = solver.solve();
    ASSERT_EQ(result.outcome, DisplacementOutcome::Converged) << result.failure;
    const double energy = reference::energy(small.problem, small.start_mm);
    // Single precision sums of a few hundred terms.
    EXPECT_NEAR(result.energies[0], energy, 1e-5 * energy);
    const Eigen::VectorXd expected = reference::gauss_newton_step(small.problem, small.start_mm, 7);
    const Eigen::VectorXd found = to_vector(result.displacements_mm);
    // The Jacobian is kept in half precision (relative rounding 5e-4); its right side is not.
    EXPECT_LT((found - expected).norm(), 3e-3 * (expected - small.start_mm).norm());
    for (Eigen::Index i = 0; i < found.size(); ++i) {
      if (small.problem.fixed[static_cast<std::size_t>(i)] != 0) {
        EXPECT_EQ(found[i], 0);
      }
    }
    const double after = reference::energy(small.problem, found);
    EXPECT_NEAR(result.energies[1], after, 1e-5 * after);
  }
}

TEST_F(DisplacementSolverTest, ReachesTheMinimumOfTheReference) {
  test::SmallProblem small = test::make_problem(9, 7, 43, 1);
  small.problem.robust_scale = 0;
  Eigen::VectorXd exact = small.start_mm;
  for (int step = 0; step < 20; ++step) {
    exact = reference::gauss_newton_step(small.problem, exact, 0);
  }
  const double least = reference::energy(small.problem, exact);
  struct Way {
    std::uint32_t patch_vertices;
    int steps;
    int iterations;
  };
  // As the device wants it, which is one patch here; and in small patches.
  for (const Way way : {Way{0, 20, 100}, Way{40, 60, 30}}) {
    SCOPED_TRACE(way.patch_vertices);
    DisplacementProblem problem = to_gpu(small);
    problem.patch_vertices = way.patch_vertices;
    DisplacementSolver solver(context());
    solver.load(problem, options_of(small.problem, way.steps, way.iterations));
    const DisplacementResult result = solver.solve();
    // The gradient is exact, so half precision changes the way but not the end.
    EXPECT_NEAR(result.energies.back(), least, 1e-4 * least);
    EXPECT_LT((to_vector(result.displacements_mm) - exact).norm(), 1e-2 * exact.norm());
  }
}

TEST_F(DisplacementSolverTest, AStepOfPatchesLowersTheEnergyAlmostAsOneOfTheWhole) {
  const test::SmallProblem small = test::make_problem(30, 30, 45, 1);
  DisplacementProblem problem = to_gpu(small);
  DisplacementSolver solver(context());
  solver.load(problem, options_of(small.problem, 1, 7));
  const std::vector<double> whole = solver.solve().energies;
  problem.patch_vertices = 200;
  solver.load(problem, options_of(small.problem, 1, 7));
  const std::vector<double> patches = solver.solve().energies;
  EXPECT_NEAR(patches[0], whole[0], 1e-6 * whole[0]);
  EXPECT_GT(whole[0] - whole[1], 0);
  EXPECT_GT(patches[0] - patches[1], 0.95 * (whole[0] - whole[1]));
}

TEST_F(DisplacementSolverTest, SolvesAgainFromTheStart) {
  const test::SmallProblem small = test::make_problem(6, 6, 47);
  DisplacementSolver solver(context());
  solver.load(to_gpu(small), options_of(small.problem, 3, 7));
  const DisplacementResult first = solver.solve();
  const DisplacementResult second = solver.solve();
  EXPECT_EQ(first.displacements_mm, second.displacements_mm);
}

TEST_F(DisplacementSolverTest, HoldsDisplacementsWithinTheBound) {
  const test::SmallProblem small = test::make_problem(6, 6, 53);
  DisplacementOptions options = options_of(small.problem, 4, 7);
  options.smooth_weight = options.coarse_weight = options.hierarchy_weight = 1e-9F;
  options.bound_mm = 0.25F;
  DisplacementSolver solver(context());
  solver.load(to_gpu(small), options);
  const DisplacementResult result = solver.solve();
  float largest = 0;
  for (const float d : result.displacements_mm) {
    largest = std::max(largest, std::abs(d));
  }
  EXPECT_EQ(largest, 0.25F);
}

TEST_F(DisplacementSolverTest, SaysWhenTheNumbersAreGone) {
  const test::SmallProblem small = test::make_problem(4, 4, 59);
  DisplacementProblem problem = to_gpu(small);
  Eigen::Index seen = 0;
  while (small.problem.data_weight[seen] == 0) {
    ++seen;
  }
  problem.colours(0, seen) = std::numeric_limits<float>::quiet_NaN();
  DisplacementSolver solver(context());
  solver.load(problem, options_of(small.problem, 1, 3));
  const DisplacementResult result = solver.solve();
  EXPECT_EQ(result.outcome, DisplacementOutcome::NumericalFailure);
  EXPECT_FALSE(result.failure.empty());
}

TEST_F(DisplacementSolverTest, RefusesArraysOfTheWrongLength) {
  const test::SmallProblem small = test::make_problem(3, 3, 61);
  DisplacementProblem problem = to_gpu(small);
  problem.start_mm.pop_back();
  DisplacementSolver solver(context());
  EXPECT_THROW(solver.load(problem, {}), Error);
}

}  // namespace
}  // namespace facet::refine
