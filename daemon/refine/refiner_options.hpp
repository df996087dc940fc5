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

/// Of the level that learns it. known_skin: SubjectSetup::skin_albedo
AlbedoOptions albedo_options(const RefinerConfig& config, bool known_skin);

/// Of one level's solve. has_prior: there is a coarser level, or displacements were given
DisplacementOptions displacement_options(const RefinerConfig& config, bool known_shape, bool has_prior,
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
