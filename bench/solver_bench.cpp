// The Gauss-Newton displacement step [MD19 eq. 5-8] through the product's GPU path, through a
// version written by hand for this CPU's vector units, and through Ceres, on the same problem and energy in
// the same run. Prints markdown; exits 1 where the three energies differ by more than one percent or the
// product is not four times as fast as Ceres at the size that the bar names.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "ceres_solver.hpp"
#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "solver_problem.hpp"
#include "support/displacement_solver.hpp"
#include "vector_solver.hpp"

namespace {

using facet::bench::SolverProblem;

constexpr double energy_tolerance = 0.01;
constexpr double needed_speedup = 4;
// The bar on speed is set at 50 K vertices; it is checked at sizes near that.
constexpr double bar_vertices_least = 45e3;
constexpr double bar_vertices_most = 55e3;

struct Options {
  std::vector<std::size_t> vertices{12'100, 50'176, 199'809};
  std::size_t ceres_most_vertices = 60'000;
  int steps = 10;
  int pcg_iterations = 7;
  int repeats = 5;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  std::uint32_t seed = 20261121;
  std::string device = "auto";
};

/// One way of solving one problem.
struct Row {
  std::string solver;
  double step_ms = 0;
  double energy = 0;
  double error_mm = 0;
};

Row measure_gpu(facet::gpu::Context& context, const SolverProblem& problem, const Options& options) {
  facet::refine::DisplacementSolver solver(context);
  facet::refine::DisplacementOptions solve = problem.options;
  solve.gauss_newton_steps = options.steps;
  solve.pcg_iterations = options.pcg_iterations;
  solver.load(problem.problem, solve);
  Row row{fmt::format("Facet, {}", context.info().name), std::numeric_limits<double>::max(), 0, 0};
  for (int repeat = 0; repeat < options.repeats; ++repeat) {
    const facet::refine::DisplacementResult result = solver.solve();
    if (result.outcome != facet::refine::DisplacementOutcome::Converged) {
      throw facet::Error(facet::ErrorKind::Internal, result.failure);
    }
    row.step_ms = std::min(row.step_ms, static_cast<double>(result.solve_ms) / options.steps);
    row.energy = facet::bench::energy(problem, result.displacements_mm);
    row.error_mm = facet::bench::rms_error_mm(problem, result.displacements_mm);
  }
  return row;
}

Row measure_vector(const SolverProblem& problem, const Options& options) {
  facet::bench::VectorSolver solver(problem, options.threads);
  Row row{fmt::format("hand-vectorised C++, {} threads", options.threads), std::numeric_limits<double>::max(),
          0, 0};
  for (int repeat = 0; repeat < options.repeats; ++repeat) {
    const facet::bench::VectorResult result = solver.solve(options.steps, options.pcg_iterations);
    row.step_ms = std::min(row.step_ms, result.step_ms);
    row.energy = facet::bench::energy(problem, result.displacements_mm);
    row.error_mm = facet::bench::rms_error_mm(problem, result.displacements_mm);
  }
  return row;
}

#ifdef FACET_CERES
Row measure_ceres(const SolverProblem& problem, const Options& options, bool to_convergence) {
  constexpr int most_steps = 100;
  Row row{"", std::numeric_limits<double>::max(), 0, 0};
  for (int repeat = 0; repeat < (to_convergence ? 1 : options.repeats); ++repeat) {
    const facet::bench::CeresResult result =
        facet::bench::solve_with_ceres(problem, to_convergence ? most_steps : options.steps,
                                       to_convergence ? 0 : options.pcg_iterations, options.threads);
    row.solver = to_convergence ? fmt::format("Ceres CGNR to convergence, {} steps", result.steps)
                                : fmt::format("Ceres CGNR, {} iterations, {} threads", options.pcg_iterations,
                                              options.threads);
    row.step_ms = std::min(row.step_ms, result.step_ms);
    row.energy = facet::bench::energy(problem, result.displacements_mm);
    row.error_mm = facet::bench::rms_error_mm(problem, result.displacements_mm);
  }
  return row;
}
#endif

/// Prints the rows of one size and checks the bars; the first row is the product's.
bool report(std::size_t vertices, const std::vector<Row>& rows, double start_energy) {
  const Row& product = rows.front();
  double least = product.energy;
  double most = product.energy;
  for (const Row& row : rows) {
    fmt::print("| {} | {} | {:.2f} | {:.2f} | {:.4f} | {:.4f} |\n", vertices, row.solver, row.step_ms,
               row.step_ms / product.step_ms, row.energy / start_energy, row.error_mm);
    least = std::min(least, row.energy);
    most = std::max(most, row.energy);
  }
  bool met = true;
  if (!(most / least - 1 <= energy_tolerance)) {
    fmt::print(stderr, "{} vertices: the energies differ by {:.2f} %, more than {:.0f} %\n", vertices,
               100 * (most / least - 1), 100 * energy_tolerance);
    met = false;
  }
  const auto count = static_cast<double>(vertices);
  const auto ceres =
      std::find_if(rows.begin(), rows.end(), [](const Row& row) { return row.solver.starts_with("Ceres"); });
  if (count >= bar_vertices_least && count <= bar_vertices_most && ceres != rows.end() &&
      !(ceres->step_ms >= needed_speedup * product.step_ms)) {
    fmt::print(stderr, "{} vertices: {:.2f} times as fast as Ceres, less than {:.0f}\n", vertices,
               ceres->step_ms / product.step_ms, needed_speedup);
    met = false;
  }
  return met;
}

bool run(const Options& options) {
  facet::gpu::ContextOptions context_options;
  context_options.device = options.device;
  facet::gpu::Context context(context_options);
  fmt::print(
      "{} Gauss-Newton steps of {} PCG iterations from the coarser level's displacements; ms are of one "
      "step, the "
      "best of {} runs.\n\n",
      options.steps, options.pcg_iterations, options.repeats);
  fmt::print(
      "| vertices | solver | ms per step | times the product's | energy / start | rms to truth, mm |\n"
      "|---|---|---|---|---|---|\n");
  bool met = true;
  for (const std::size_t wanted : options.vertices) {
    SolverProblem problem;
    facet::bench::make_problem(wanted, options.seed, problem);
    std::vector<Row> rows{measure_gpu(context, problem, options), measure_vector(problem, options)};
#ifdef FACET_CERES
    if (problem.vertex_count() <= options.ceres_most_vertices) {
      rows.push_back(measure_ceres(problem, options, false));
      rows.push_back(measure_ceres(problem, options, true));
    }
#endif
    const double start_energy = facet::bench::energy(problem, problem.problem.start_mm);
    met = report(problem.vertex_count(), rows, start_energy) && met;
    std::fflush(stdout);
  }
  return met;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Measures the displacement solver against hand-vectorised C++ and Ceres.");
  app.add_option("--vertices", options.vertices, "Vertex counts (squares)")
      ->delimiter(',')
      ->capture_default_str();
  app.add_option("--ceres-most-vertices", options.ceres_most_vertices,
                 "Larger problems are not given to Ceres; a program built without it gives it none")
      ->capture_default_str();
  app.add_option("--steps", options.steps, "Gauss-Newton steps")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--pcg", options.pcg_iterations, "PCG iterations of each step")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--repeats", options.repeats, "Runs of each, the best counts")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--threads", options.threads, "Threads of the CPU solvers")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--seed", options.seed, "Of the image noise")->capture_default_str();
  app.add_option("--device", options.device, "Vulkan device: auto or part of its name")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options) ? 0 : 1;
  } catch (const facet::Error& error) {
    fmt::print(stderr, "solver_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
