#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "mesh/mesh.hpp"
#include "render/renderer.hpp"
#include "simulation/virtual_booth.hpp"

namespace facet::bench {

struct Spread {
  explicit Spread(std::vector<double> values);
  double mean() const;
  /// share: 0.5 is the median.
  double at(double share) const;
  std::vector<double> sorted;
};

/// The point of the true skin that a vertex of the template is to follow; triangle -1: none.
struct Follower {
  std::int32_t triangle = -1;
  Eigen::Vector2f barycentric{0, 0};
};

/// Triangles that look the other way than the surface around them, of those whose corners all count.
int find_folded(const mesh::Triangles& triangles, const mesh::Vertices& vertices_mm,
                const std::function<bool(std::size_t)>& counts, std::vector<std::uint8_t>& folded);

/// From the true skin to a mesh: distances in mm and angles between the normals in degrees.
struct SurfaceError {
  std::vector<double> distances_mm;
  std::vector<double> angles_deg;

  /// skin: [truth vertex_count]; counts: whether a vertex of the mesh does
  void add(const simulation::TruthMesh& truth, const Eigen::VectorXf& skin, const mesh::Triangles& triangles,
           const mesh::Vertices& vertices_mm, const std::function<bool(std::size_t)>& counts);
};

/// How smoothly the template moves, and how far it lags behind what moves.
class Motion {
 public:
  /// The next mesh. followers: [template vertex_count]
  void add(const std::vector<Follower>& followers, const simulation::TruthMesh& truth,
           const mesh::Vertices& now_mm);

  /// The mesh that was added last; empty before the first.
  const mesh::Vertices& last_mm() const { return last_mm_; }
  /// rms of the second differences over three meshes, mm.
  double jitter_mm() const;
  /// Meshes.
  double lag() const;

 private:
  mesh::Vertices older_mm_;
  mesh::Vertices last_mm_;
  mesh::Vertices last_truth_mm_;
  double jitter_squares_ = 0;
  double jitter_count_ = 0;
  double lag_sum_ = 0;
  double lag_squares_ = 0;
};

/// How far meshes between those of blank slots are from the truth, mm.
struct BetweenError {
  std::array<std::vector<double>, 2> distances;  ///< [0]: of the way between the meshes, [1]: settled
  std::array<std::vector<double>, 2> drifts;
  std::vector<double> ms;

  /// followers: [template vertex_count]; caster: of the truth
  void add(bool settled, const std::vector<Follower>& followers, const simulation::TruthMesh& truth,
           const render::Raycaster& caster, const mesh::Vertices& mesh_mm);
  void print() const;
};

}  // namespace facet::bench
