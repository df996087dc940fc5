#include "template_measures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <string>
#include <utility>

namespace facet::bench {

Spread::Spread(std::vector<double> values) : sorted(std::move(values)) {
  std::sort(sorted.begin(), sorted.end());
}

double Spread::mean() const {
  return sorted.empty()
             ? 0
             : std::accumulate(sorted.begin(), sorted.end(), 0.0) / static_cast<double>(sorted.size());
}

double Spread::at(double share) const {
  return sorted.empty() ? 0
                        : sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}

int find_folded(const mesh::Triangles& triangles, const mesh::Vertices& vertices_mm,
                const std::function<bool(std::size_t)>& counts, std::vector<std::uint8_t>& folded) {
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, triangles, normals);
  folded.assign(static_cast<std::size_t>(triangles.cols()), 0);
  int found = 0;
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto corner = triangles.col(t);
    const Eigen::Vector3f n = (vertices_mm.col(corner[1]) - vertices_mm.col(corner[0]))
                                  .cross(vertices_mm.col(corner[2]) - vertices_mm.col(corner[0]));
    if (counts(static_cast<std::size_t>(corner[0])) && counts(static_cast<std::size_t>(corner[1])) &&
        counts(static_cast<std::size_t>(corner[2])) &&
        n.dot(normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2])) < 0) {
      folded[static_cast<std::size_t>(t)] = 1;
      ++found;
    }
  }
  return found;
}

void SurfaceError::add(const simulation::TruthMesh& truth, const Eigen::VectorXf& skin,
                       const mesh::Triangles& triangles, const mesh::Vertices& vertices_mm,
                       const std::function<bool(std::size_t)>& counts) {
  const render::Raycaster caster(vertices_mm, triangles);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, triangles, normals);
  for (Eigen::Index v = 0; v < truth.vertices_mm.cols(); v += 3) {
    if (skin[v] < 0.9F) {
      continue;
    }
    const auto hit = caster.closest_point(truth.vertices_mm.col(v), 5);
    if (hit.triangle < 0) {
      continue;
    }
    const auto corner = triangles.col(hit.triangle);
    if (!counts(static_cast<std::size_t>(corner[0])) || !counts(static_cast<std::size_t>(corner[1])) ||
        !counts(static_cast<std::size_t>(corner[2]))) {
      continue;
    }
    distances_mm.push_back(static_cast<double>(hit.distance_mm));
    const float cosine = render::interpolate(triangles, hit.triangle, hit.barycentric, normals)
                             .normalized()
                             .dot(truth.normals.col(v));
    angles_deg.push_back(std::acos(std::clamp(static_cast<double>(cosine), -1.0, 1.0)) * 180 /
                         std::numbers::pi);
  }
}

void Motion::add(const std::vector<Follower>& followers, const simulation::TruthMesh& truth,
                 const mesh::Vertices& now_mm) {
  // Second differences over three meshes.
  for (std::size_t v = 0; v < followers.size() && older_mm_.cols() > 0; ++v) {
    if (followers[v].triangle >= 0) {
      const auto column = static_cast<Eigen::Index>(v);
      jitter_squares_ += static_cast<double>(
          (now_mm.col(column) - 2 * last_mm_.col(column) + older_mm_.col(column)).squaredNorm());
      jitter_count_ += 1;
    }
  }
  const bool first = last_truth_mm_.cols() == 0;
  const mesh::Vertices truth_move_mm =
      first ? mesh::Vertices() : mesh::Vertices(truth.vertices_mm - last_truth_mm_);
  for (std::size_t v = 0; v < followers.size() && !first; ++v) {
    if (followers[v].triangle >= 0) {
      const Eigen::Vector3f move = render::interpolate(truth.triangles, followers[v].triangle,
                                                       followers[v].barycentric, truth_move_mm);
      const Eigen::Vector3f behind = render::interpolate(truth.triangles, followers[v].triangle,
                                                         followers[v].barycentric, truth.vertices_mm) -
                                     now_mm.col(static_cast<Eigen::Index>(v));
      if (move.norm() > 2) {
        lag_sum_ += static_cast<double>(behind.dot(move));
        lag_squares_ += static_cast<double>(move.squaredNorm());
      }
    }
  }
  older_mm_ = last_mm_;
  last_mm_ = now_mm;
  last_truth_mm_ = truth.vertices_mm;
}

double Motion::jitter_mm() const {
  return std::sqrt(jitter_squares_ / std::max(jitter_count_, 1.0));
}

double Motion::lag() const {
  return lag_sum_ / std::max(lag_squares_, 1e-9);
}

void BetweenError::add(bool settled, const std::vector<Follower>& followers,
                       const simulation::TruthMesh& truth, const render::Raycaster& caster,
                       const mesh::Vertices& mesh_mm) {
  for (std::size_t v = 0; v < followers.size(); ++v) {
    if (followers[v].triangle < 0) {
      continue;
    }
    const Eigen::Vector3f true_mm = render::interpolate(truth.triangles, followers[v].triangle,
                                                        followers[v].barycentric, truth.vertices_mm);
    const Eigen::Vector3f at = mesh_mm.col(static_cast<Eigen::Index>(v));
    const auto hit = caster.closest_point(at, 30);
    distances[settled].push_back(hit.triangle >= 0 ? static_cast<double>(hit.distance_mm) : 30.0);
    drifts[settled].push_back(static_cast<double>((true_mm - at).norm()));
  }
}

void BetweenError::print() const {
  for (const bool settled : {false, true}) {
    const Spread distance(distances[settled]);
    const Spread drift(drifts[settled]);
    fmt::print("between, {}: distance mean {:.3f} p95 {:.3f} mm, skin point mean {:.2f} p95 {:.2f} mm{}\n",
               settled ? "on the depth maps" : "half way alone", distance.mean(), distance.at(0.95),
               drift.mean(), drift.at(0.95),
               settled ? fmt::format("; {:.0f} ms a mesh", Spread(ms).mean()) : "");
  }
}

}  // namespace facet::bench
