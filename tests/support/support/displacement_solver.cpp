#include "support/displacement_solver.hpp"

#include <fmt/format.h>

#include <cmath>
#include <cstddef>
#include <optional>
#include <span>

#include "facet/error.hpp"
#include "refine/device_order.hpp"
#include "refine/lighting.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {
namespace {

using shaders::vec4;

vec4 join(const Eigen::Matrix3Xf& columns, Eigen::Index column, float fourth) {
  return {columns(0, column), columns(1, column), columns(2, column), fourth};
}

float ring_spacing(const DisplacementProblem& problem, Eigen::Index vertex) {
  const auto v = static_cast<std::size_t>(vertex);
  const mesh::OneRings& rings = *problem.one_rings;
  float sum = 0;
  for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
    const Eigen::Index other = rings.neighbours[static_cast<std::size_t>(k)];
    sum += (problem.vertices_mm.col(other) - problem.vertices_mm.col(vertex)).norm();
  }
  return sum / static_cast<float>(rings.offsets[v + 1] - rings.offsets[v]);
}

void check(const DisplacementProblem& problem) {
  if (problem.one_rings == nullptr) {
    throw Error(ErrorKind::Usage, "a displacement problem needs its one-rings");
  }
  const std::size_t count = problem.one_rings->on_boundary.size();
  const auto need = [&](const char* what, std::size_t found) {
    if (found != count) {
      throw Error(ErrorKind::Usage,
                  fmt::format("a displacement problem of {} vertices has {} {}", count, found, what));
    }
  };
  need("vertices", static_cast<std::size_t>(problem.vertices_mm.cols()));
  need("normals", static_cast<std::size_t>(problem.normals.cols()));
  need("colours", static_cast<std::size_t>(problem.colours.cols()));
  need("data weights", problem.data_weight.size());
  need("albedos", static_cast<std::size_t>(problem.albedo.cols()));
  need("fixed flags", problem.fixed.size());
  need("prolonged displacements", problem.prolonged_mm.size());
  need("start displacements", problem.start_mm.size());
}

}  // namespace

/// Everything of one loaded problem; a new load replaces it as a whole.
struct LoadedProblem {
  LoadedProblem(gpu::Context& context, const DisplacementKernels& kernels, const DisplacementProblem& problem,
                const DisplacementOptions& chosen);

  DisplacementOptions options;
  LevelTopology topology;
  LevelState state;
  SolverScratch scratch;
  gpu::Buffer light;
  gpu::Buffer start;   ///< positions with the start displacements
  gpu::Buffer solved;  ///< positions with the displacements found
  gpu::Batch batch;
};

struct DisplacementSolver::Impl {
  explicit Impl(gpu::Context& used) : context(used), kernels(used) {}

  gpu::Context& context;
  DisplacementKernels kernels;
  std::optional<LoadedProblem> loaded;
};

namespace {

std::vector<std::uint8_t> free_of(const DisplacementProblem& problem) {
  std::vector<std::uint8_t> free(problem.fixed.size());
  for (std::size_t v = 0; v < free.size(); ++v) {
    free[v] = problem.fixed[v] == 0 ? 1 : 0;
  }
  return free;
}

/// The problem's vertices stay in their order; patches are cut where they lie in x and y.
std::vector<std::int32_t> curve_of(const DisplacementProblem& problem) {
  const DeviceOrder order = device_order(*problem.one_rings, problem.vertices_mm.topRows<2>());
  std::vector<std::int32_t> curve;
  for (const std::int32_t device : order.curve) {
    curve.push_back(order.host_index[static_cast<std::size_t>(device)]);
  }
  return curve;
}

}  // namespace

LoadedProblem::LoadedProblem(gpu::Context& context, const DisplacementKernels& kernels,
                             const DisplacementProblem& problem, const DisplacementOptions& chosen)
    : options(chosen),
      topology(context, *problem.one_rings, free_of(problem), curve_of(problem), {}, problem.patch_vertices),
      state(context, topology.vertex_count),
      scratch(context, topology.vertex_count, topology.group_count, topology.patches.place_count,
              static_cast<std::uint32_t>(chosen.gauss_newton_steps) + 1),
      light(context, sizeof(shaders::refine::Light), gpu::Memory::Device, "light"),
      start(context, topology.vertex_count * sizeof(vec4), gpu::Memory::Device, "start"),
      solved(context, topology.vertex_count * sizeof(vec4), gpu::Memory::Readback, "solved"),
      batch(context, "displacement solver") {
  std::vector<vec4> positions(topology.vertex_count);
  std::vector<vec4> normals(topology.vertex_count);
  std::vector<vec4> colours(topology.vertex_count);
  std::vector<vec4> albedo(topology.vertex_count);
  std::vector<vec4> irradiance(topology.vertex_count, vec4{0, 0, 0, 0});
  for (std::size_t v = 0; v < topology.vertex_count; ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    const bool fixed = problem.fixed[v] != 0 || problem.one_rings->on_boundary[v] != 0;
    positions[v] = join(problem.vertices_mm, column, fixed ? 0 : problem.start_mm[v]);
    normals[v] = join(problem.normals, column, ring_spacing(problem, column));
    colours[v] =
        join(problem.colours, column, problem.one_rings->on_boundary[v] != 0 ? 0 : problem.data_weight[v]);
    albedo[v] = join(problem.albedo, column, 1);
    if (problem.irradiance.cols() > 0) {
      const auto value = problem.irradiance.col(column);
      irradiance[v] = {value[0], value[1], value[2], value[3]};
    }
  }
  gpu::upload(context, start, std::as_bytes(std::span(positions)));
  gpu::upload(context, state.normals.buffer, std::as_bytes(std::span(normals)));
  gpu::upload(context, state.colours.buffer, std::as_bytes(std::span(colours)));
  gpu::upload(context, state.albedo.buffer, std::as_bytes(std::span(albedo)));
  gpu::upload(context, state.irradiance.buffer, std::as_bytes(std::span(irradiance)));
  gpu::upload(context, state.priors.buffer, std::as_bytes(std::span(problem.prolonged_mm)));
  const shaders::refine::Light packed = pack_light(problem.lighting, problem.gain);
  gpu::upload(context, light, std::as_bytes(std::span(&packed, 1)));

  batch.stage("start");
  batch.copy(start, state.positions.buffer);
  batch.stage("solve");
  kernels.record(batch, topology, state, scratch, light, options, 0);
  batch.stage("finish");
  kernels.record_energy(batch, topology, state, scratch, light, options,
                        static_cast<std::uint32_t>(options.gauss_newton_steps));
  batch.copy(state.positions.buffer, solved);
  batch.finish();
}

DisplacementSolver::DisplacementSolver(gpu::Context& context) : impl_(std::make_unique<Impl>(context)) {}
DisplacementSolver::~DisplacementSolver() = default;

void DisplacementSolver::load(const DisplacementProblem& problem, const DisplacementOptions& options) {
  check(problem);
  impl_->loaded.reset();
  impl_->loaded.emplace(impl_->context, impl_->kernels, problem, options);
}

DisplacementResult DisplacementSolver::solve() {
  DisplacementResult out;
  if (!impl_->loaded) {
    throw Error(ErrorKind::Usage, "DisplacementSolver::solve needs a problem: call load first");
  }
  LoadedProblem& loaded = *impl_->loaded;
  if (loaded.batch.submit() != gpu::Outcome::Done || loaded.batch.wait() != gpu::Outcome::Done) {
    out.outcome = DisplacementOutcome::DeviceLost;
    out.failure = "the GPU was lost during the solve";
    return out;
  }
  out.solve_ms = loaded.batch.stage_ms("solve");
  bool finite = true;
  for (int step = 0; step <= loaded.options.gauss_newton_steps; ++step) {
    out.energies.push_back(
        loaded.scratch.energy(static_cast<std::uint32_t>(step), loaded.topology.workgroup_count));
    finite = finite && std::isfinite(out.energies.back());
  }
  for (const vec4& position : loaded.solved.mapped_as<vec4>()) {
    out.displacements_mm.push_back(position.w);
    finite = finite && std::isfinite(position.w);
  }
  if (!finite) {
    out.outcome = DisplacementOutcome::NumericalFailure;
    out.failure = fmt::format("the solve left finite numbers; energy {} at its start, {} at its end",
                              out.energies.front(), out.energies.back());
  }
  return out;
}

}  // namespace facet::refine
