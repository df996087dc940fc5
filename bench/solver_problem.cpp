#include "solver_problem.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace facet::bench {
namespace {

constexpr float side_mm = 160;
constexpr float pi = 3.14159265F;

/// Height of the coarse sheet over its plane: a dome like a face's.
float dome_mm(float x_mm, float y_mm) {
  return -0.004F * x_mm * x_mm - 0.002F * y_mm * y_mm +
         6.0F * std::exp(-(x_mm * x_mm + y_mm * y_mm) / 400.0F);
}

/// Bumps of centimetres.
float bumps_mm(float x_mm, float y_mm) {
  return 0.25F * std::sin(2 * pi * x_mm / 40) * std::cos(2 * pi * y_mm / 55);
}

/// Wrinkles of eight millimetres' width.
float wrinkles_mm(float x_mm, float y_mm) {
  const float across = y_mm + 4 * std::sin(2 * pi * x_mm / 60);
  return 0.2F * std::sin(2 * pi * across / 8) * std::exp(-x_mm * x_mm / 1800.0F);
}

/// A grid whose quads' diagonals meet in every second vertex: valences 4 and 8 inside, as after 4-8
/// subdivision.
mesh::Triangles grid_triangles(int vertices_a_side) {
  const int cells = vertices_a_side - 1;
  mesh::Triangles triangles(3, Eigen::Index{2} * cells * cells);
  Eigen::Index next = 0;
  for (int row = 0; row < cells; ++row) {
    for (int column = 0; column < cells; ++column) {
      const int a = row * vertices_a_side + column;
      const int b = a + 1;
      const int c = b + vertices_a_side;
      const int d = a + vertices_a_side;
      if ((row + column) % 2 == 0) {
        triangles.col(next++) << a, b, c;
        triangles.col(next++) << a, c, d;
      } else {
        triangles.col(next++) << a, b, d;
        triangles.col(next++) << b, c, d;
      }
    }
  }
  return triangles;
}

struct Ring {
  const std::int32_t* vertices;
  int size;
};

Ring ring_of(const mesh::OneRings& rings, std::size_t vertex) {
  return {rings.neighbours.data() + rings.offsets[vertex], rings.offsets[vertex + 1] - rings.offsets[vertex]};
}

/// n*_i of [MD19 eq. 5] for an inner vertex, not normalised.
Eigen::Vector3d displaced_normal(const SolverProblem& problem, const std::vector<float>& displacements_mm,
                                 std::size_t vertex) {
  const auto displaced = [&](std::int32_t index) -> Eigen::Vector3d {
    return problem.problem.vertices_mm.col(index).cast<double>() +
           static_cast<double>(displacements_mm[static_cast<std::size_t>(index)]) *
               problem.problem.normals.col(index).cast<double>();
  };
  const Ring ring = ring_of(problem.rings, vertex);
  const Eigen::Vector3d centre = displaced(static_cast<std::int32_t>(vertex));
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int k = 0; k < ring.size; ++k) {
    const Eigen::Vector3d a = displaced(ring.vertices[k]) - centre;
    const Eigen::Vector3d b = displaced(ring.vertices[(k + 1) % ring.size]) - centre;
    sum += a.cross(b);
  }
  return sum;
}

/// l . SH(n) [MD19 eq. 1].
double shade(const std::array<float, 9>& lighting, const Eigen::Vector3d& n) {
  const std::array<double, 9> basis{1,
                                    n.x(),
                                    n.y(),
                                    n.z(),
                                    n.x() * n.y(),
                                    n.x() * n.z(),
                                    n.y() * n.z(),
                                    n.x() * n.x() - n.y() * n.y(),
                                    3 * n.z() * n.z() - 1};
  double sum = 0;
  for (std::size_t band = 0; band < basis.size(); ++band) {
    sum += static_cast<double>(lighting[band]) * basis[band];
  }
  return sum;
}

}  // namespace

void make_problem(std::size_t vertex_count, std::uint32_t seed, SolverProblem& out) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  const int vertices_a_side = static_cast<int>(std::lround(std::sqrt(static_cast<double>(vertex_count))));
  const Eigen::Index count = Eigen::Index{vertices_a_side} * vertices_a_side;
  const auto size = static_cast<std::size_t>(count);
  const float step_mm = side_mm / static_cast<float>(vertices_a_side - 1);

  refine::DisplacementProblem& problem = out.problem;
  problem.vertices_mm.resize(3, count);
  out.truth_mm.assign(size, 0);
  problem.prolonged_mm.assign(size, 0);
  const mesh::Triangles triangles = grid_triangles(vertices_a_side);
  out.rings = mesh::build_one_rings(triangles, static_cast<std::int32_t>(count));
  problem.one_rings = &out.rings;
  for (Eigen::Index i = 0; i < count; ++i) {
    const float x_mm = static_cast<float>(i % vertices_a_side) * step_mm - side_mm / 2;
    const float y_mm = static_cast<float>(i / vertices_a_side) * step_mm - side_mm / 2;
    problem.vertices_mm.col(i) << x_mm, y_mm, dome_mm(x_mm, y_mm);
    const auto v = static_cast<std::size_t>(i);
    if (out.rings.on_boundary[v] == 0) {
      problem.prolonged_mm[v] = bumps_mm(x_mm, y_mm);
      out.truth_mm[v] = bumps_mm(x_mm, y_mm) + wrinkles_mm(x_mm, y_mm);
    }
  }
  problem.start_mm = problem.prolonged_mm;
  mesh::vertex_normals(problem.vertices_mm, triangles, problem.normals);
  out.spacing_mm.assign(size, 0);
  for (std::size_t v = 0; v < size; ++v) {
    const Ring ring = ring_of(out.rings, v);
    for (int k = 0; k < ring.size; ++k) {
      out.spacing_mm[v] +=
          (problem.vertices_mm.col(ring.vertices[k]) - problem.vertices_mm.col(static_cast<Eigen::Index>(v)))
              .norm() /
          static_cast<float>(ring.size);
    }
  }

  problem.lighting = {0.55F, 0.15F, 0.25F, 0.4F, 0.03F, -0.05F, 0.06F, -0.04F, 0.05F};
  problem.colours = Eigen::Matrix3Xf::Zero(3, count);
  problem.albedo.resize(3, count);
  problem.data_weight.assign(size, 0);
  problem.fixed.assign(size, 0);
  double square_sum = 0;
  for (std::size_t v = 0; v < size; ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    const float tint = 0.03F * std::sin(0.1F * problem.vertices_mm(0, column));
    problem.albedo.col(column) << 0.6F + tint, 0.42F + tint, 0.33F - tint;
    problem.fixed[v] = out.rings.on_boundary[v];
    if (out.rings.on_boundary[v] != 0) {
      continue;
    }
    problem.data_weight[v] = 1;
    const Eigen::Vector3d seen = displaced_normal(out, out.truth_mm, v).normalized();
    problem.colours.col(column) =
        static_cast<float>(shade(problem.lighting, seen)) * problem.albedo.col(column) +
        0.004F * Eigen::Vector3f(normal(random), normal(random), normal(random));
    square_sum += static_cast<double>(problem.colours.col(column).squaredNorm());
  }
  problem.gain = static_cast<float>(3 * static_cast<double>(size) / square_sum);

  // The orders of magnitude that the product uses; every solver gets the same.
  out.options.smooth_weight = 0.02F;
  out.options.hierarchy_weight = 0.005F;
  out.options.coarse_weight = 0.0005F;
  out.options.robust_scale = 0;
}

double energy(const SolverProblem& problem, const std::vector<float>& displacements_mm) {
  const refine::DisplacementProblem& given = problem.problem;
  const refine::DisplacementOptions& options = problem.options;
  double sum = 0;
  for (std::size_t v = 0; v < problem.vertex_count(); ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    if (given.data_weight[v] > 0) {
      const Eigen::Vector3d normal = displaced_normal(problem, displacements_mm, v).normalized();
      const Eigen::Vector3d residual =
          given.colours.col(column).cast<double>() -
          shade(given.lighting, normal) * given.albedo.col(column).cast<double>();
      sum += static_cast<double>(given.data_weight[v]) * static_cast<double>(given.gain) *
             residual.squaredNorm();
    }
    const Ring ring = ring_of(problem.rings, v);
    const auto own = static_cast<double>(displacements_mm[v]);
    double mean = 0;
    for (int k = 0; k < ring.size; ++k) {
      mean += static_cast<double>(displacements_mm[static_cast<std::size_t>(ring.vertices[k])]) / ring.size;
    }
    const auto spacing = static_cast<double>(problem.spacing_mm[v]);
    const double bend = (own - mean) / spacing;
    const double detail = (static_cast<double>(given.prolonged_mm[v]) - own) / spacing;
    sum += static_cast<double>(options.smooth_weight) * bend * bend +
           static_cast<double>(options.hierarchy_weight) * detail * detail +
           static_cast<double>(options.coarse_weight) * own * own;
  }
  return sum;
}

double rms_error_mm(const SolverProblem& problem, const std::vector<float>& displacements_mm) {
  double sum = 0;
  std::size_t inner = 0;
  for (std::size_t v = 0; v < problem.vertex_count(); ++v) {
    if (problem.rings.on_boundary[v] == 0) {
      const double error =
          static_cast<double>(displacements_mm[v]) - static_cast<double>(problem.truth_mm[v]);
      sum += error * error;
      ++inner;
    }
  }
  return std::sqrt(sum / static_cast<double>(inner));
}

}  // namespace facet::bench
