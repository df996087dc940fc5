#include "problems.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "refine/device_order.hpp"

namespace facet::refine::test {

std::vector<std::uint8_t> SmallProblem::free() const {
  std::vector<std::uint8_t> out(problem.fixed.size());
  std::ranges::transform(problem.fixed, out.begin(), [](std::uint8_t fixed) { return fixed == 0 ? 1 : 0; });
  return out;
}

std::vector<std::int32_t> SmallProblem::curve() const {
  return device_order(*problem.rings, hierarchy->texture_coordinates).curve;
}

SmallProblem make_problem(int columns, int rows, unsigned seed, int level) {
  std::mt19937 random(seed);
  std::mt19937 lamps(seed + 1);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;

  mesh::ControlMesh control;
  const int stride = columns + 1;
  control.vertex_count = stride * (rows + 1);
  control.refinable.assign(static_cast<std::size_t>(control.vertex_count), 1);
  SmallProblem out;
  out.control_mm.resize(3, control.vertex_count);
  mesh::TextureCoordinates control_px(2, control.vertex_count);
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column <= columns; ++column) {
      const int i = row * stride + column;
      const auto x = static_cast<float>(4 * column + 0.5 * normal(random));
      const auto y = static_cast<float>(4 * row + 0.5 * normal(random));
      const auto z = static_cast<float>(-0.01 * x * x - 0.02 * y * y + 0.3 * normal(random));
      out.control_mm.col(i) << x, y, z;
      control_px.col(i) << 8 * static_cast<float>(column), 8 * static_cast<float>(row);
    }
  }
  control.texture_coordinates = control_px;
  control.quads.resize(4, columns * rows);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const int i = row * stride + column;
      control.quads.col(row * columns + column) << i, i + 1, i + stride + 1, i + stride;
    }
  }
  mesh::HierarchyOptions options;
  options.min_edge_px = 3;
  options.max_levels = level + 1;
  out.hierarchy = mesh::build_hierarchy(
      control, control_px, std::vector<std::uint8_t>(static_cast<std::size_t>(control.vertex_count), 1),
      options);
  std::vector<mesh::Vertices> positions;
  mesh::push_positions(*out.hierarchy, out.control_mm, positions);

  reference::Problem& problem = out.problem;
  problem.rings = &out.hierarchy->finest().one_rings;
  problem.vertices_mm = positions.back().cast<double>();
  problem.normals = reference::coarse_normals(*problem.rings, problem.vertices_mm);
  problem.spacing_mm = reference::ring_spacing(*problem.rings, problem.vertices_mm);
  const Eigen::Index count = problem.vertices_mm.cols();
  problem.lighting << 0.6, 0.2, 0.25, 0.4, 0.05, -0.06, 0.07, -0.03, 0.04;
  problem.irradiance.resize(4, count);
  problem.albedo.resize(3, count);
  problem.colours.resize(3, count);
  problem.data_weight.resize(count);
  problem.fixed.assign(static_cast<std::size_t>(count), 0);
  problem.prolonged_mm.resize(count);
  out.start_mm.resize(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto v = static_cast<std::size_t>(i);
    const bool excluded = uniform(random) < 0.08;
    problem.fixed[v] = problem.rings->on_boundary[v] != 0 || excluded ? 1 : 0;
    problem.albedo.col(i) << 0.5 + 0.1 * uniform(random), 0.35 + 0.1 * uniform(random),
        0.25 + 0.1 * uniform(random);
    problem.irradiance.col(i) << 0.05 + 0.01 * normal(lamps), 0.02 * normal(lamps), 0.02 * normal(lamps),
        0.05 + 0.02 * normal(lamps);
    const Eigen::Vector3d bent =
        (problem.normals.col(i) + 0.2 * Eigen::Vector3d(normal(random), normal(random), normal(random)))
            .normalized();
    problem.colours.col(i) = reference::reflected(problem, bent, i) +
                             0.01 * Eigen::Vector3d(normal(random), normal(random), normal(random));
    problem.data_weight[i] = problem.fixed[v] != 0 || uniform(random) < 0.15 ? 0 : 0.2 + uniform(random);
    problem.prolonged_mm[i] = problem.fixed[v] != 0 ? 0 : 0.1 * normal(random);
    out.start_mm[i] = problem.fixed[v] != 0 ? 0 : 0.1 * normal(random);
  }
  problem.smooth_weight = 0.02;
  problem.hierarchy_weight = 0.01;
  problem.coarse_weight = 0.002;
  problem.robust_scale = 0.6;
  problem.fold_slope = 0.1;
  return out;
}

}  // namespace facet::refine::test
