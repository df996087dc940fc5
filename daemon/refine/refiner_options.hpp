#pragma once

// Private to this room: which steps with which weights a configuration makes.

#include <cstddef>
#include <cstdint>

#include "refine/albedo.hpp"
#include "refine/displacement_kernels.hpp"
#include "refine/refiner.hpp"
#include "refine/step_planner.hpp"

namespace facet::refine {

/// Throws Error(Usage) where it makes no step.
void check(const RefinerConfig& config);

/// The weights for a subject: of what is known of it beforehand those for that.
Weights weights_for(const SubjectSetup& subject, Weights weights);

/// Of the level that learns it. weights: weights_for the subject
AlbedoOptions albedo_options(const RefinerConfig& config, const Weights& weights);

/// Of one level's solve. weights: weights_for the subject; has_prior: there is a coarser level, or
/// displacements were given
DisplacementOptions displacement_options(const RefinerConfig& config, const Weights& weights, bool has_prior,
                                         int steps, int pcg_iterations);

/// The plan of every frame where the budget is not Budget::Auto.
StepPlan constant_plan(const RefinerConfig& config, std::size_t levels);

/// Whether a StepPlanner plans every frame; refining the finest level alone is a fixed comparison.
bool plans_frames(const RefinerConfig& config);

/// Gauss-Newton steps that a plan may have at most.
int most_steps(const RefinerConfig& config);

/// Where a level's energies begin among all.
std::uint32_t first_energy_slot(const RefinerConfig& config, std::size_t level);

}  // namespace facet::refine
