#include "refine/refiner_options.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "facet/error.hpp"

namespace facet::refine {
namespace {

constexpr int kPaperGaussNewtonSteps = 10;
constexpr int kPaperPcgIterations = 7;

}  // namespace

void check(const RefinerConfig& config) {
  if (config.gauss_newton_steps < 1 || config.pcg_iterations < 1) {
    throw Error(ErrorKind::Usage,
                fmt::format("refinement needs at least 1 Gauss-Newton step and 1 PCG iteration, not "
                            "{} and {}",
                            config.gauss_newton_steps, config.pcg_iterations));
  }
}

Weights weights_for(const SubjectSetup& subject, Weights weights) {
  if (subject.skin_albedo.cols() > 0) {
    weights.albedo_smooth = weights.albedo_smooth_known;
  }
  if (!subject.relief_mm.empty()) {
    weights.displacement_smooth = weights.displacement_smooth_known;
  }
  if (subject.known_shape) {
    weights.displacement_coarse = weights.displacement_coarse_known;
  }
  return weights;
}

AlbedoOptions albedo_options(const RefinerConfig& config, const Weights& weights) {
  AlbedoOptions out;
  out.smooth_weight = weights.albedo_smooth;
  out.frame_quota = static_cast<float>(std::max(1, config.albedo_frames));
  return out;
}

DisplacementOptions displacement_options(const RefinerConfig& config, const Weights& weights, bool has_prior,
                                         int steps, int pcg_iterations) {
  DisplacementOptions out;
  out.smooth_weight = weights.displacement_smooth;
  out.hierarchy_weight = has_prior ? weights.displacement_hierarchy : 0;
  out.coarse_weight = weights.displacement_coarse;
  out.robust_scale = config.robust_scale;
  out.fold_slope = config.fold_slope;
  out.bound_mm = config.displacement_bound_mm;
  out.gauss_newton_steps = steps;
  out.pcg_iterations = pcg_iterations;
  return out;
}

StepPlan constant_plan(const RefinerConfig& config, std::size_t levels) {
  const bool paper = config.budget == Budget::Paper;
  StepPlan plan;
  plan.steps.assign(levels, config.hierarchical ? 1 : 0);
  plan.steps.back() = 1;
  for (int& steps : plan.steps) {
    steps *= paper ? kPaperGaussNewtonSteps : config.gauss_newton_steps;
  }
  plan.pcg_iterations = paper ? kPaperPcgIterations : config.pcg_iterations;
  plan.last_energy = config.record_energies;
  return plan;
}

bool plans_frames(const RefinerConfig& config) {
  return config.budget == Budget::Auto && config.hierarchical;
}

int most_steps(const RefinerConfig& config) {
  return plans_frames(config) ? StepPlanner::kMostSteps : constant_plan(config, 1).steps.back();
}

std::uint32_t first_energy_slot(const RefinerConfig& config, std::size_t level) {
  return static_cast<std::uint32_t>(level) * static_cast<std::uint32_t>(most_steps(config) + 1);
}

}  // namespace facet::refine
