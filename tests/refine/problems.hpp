#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "mesh/hierarchy.hpp"
#include "reference.hpp"

namespace facet::refine::test {

/// A displacement problem with everything random but the topology, which is a level of a real hierarchy: with
/// boundary, excluded vertices, unseen vertices and valences from 3 to 8.
struct SmallProblem {
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  mesh::Vertices control_mm;  ///< head frame of a bent grid
  reference::Problem problem;
  Eigen::VectorXd start_mm;

  std::vector<std::uint8_t> free() const;   ///< [vertex_count] 1 where problem.fixed is 0
  std::vector<std::int32_t> curve() const;  ///< DeviceOrder::curve of the level
};

/// columns x rows control quads; level: of the hierarchy (its last where there are fewer).
SmallProblem make_problem(int columns, int rows, unsigned seed, int level = 0);

}  // namespace facet::refine::test
