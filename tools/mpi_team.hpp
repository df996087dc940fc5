#pragma once

#include <memory>

#include "depth_team.hpp"

namespace facet::tools {

/// The processes that `mpirun` started together, as a team. Throws facet::Error{Usage} where it started none,
/// {Internal} where MPI has no messages from threads. Main thread, once a process.
std::unique_ptr<Team> join_mpi_team();

}  // namespace facet::tools
