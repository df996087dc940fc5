#include "person/surface_anchor.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <map>

namespace facet::person {
namespace {

using Sparse = Eigen::SparseMatrix<double>;

/// Rings of vertices around the skin that is seen which are free to follow it.
constexpr int kMarginRings = 6;
/// Beyond the skin the anchor grows to so much, over kRimRings rings: the skull that is not seen stays the
/// model's.
constexpr double kRimStrength = 10;
constexpr int kRimRings = 4;
constexpr double kSliver = 1e-9;
constexpr double kLeastAreaMm2 = 0.5;

}  // namespace

mesh::SparseRows surface_rows(const face::FaceModel& model) {
  const auto count = static_cast<std::size_t>(model.vertex_count());
  std::vector<std::map<std::int32_t, int>> edges(count);  // of each vertex: to whom, of how many quads
  const mesh::Quads& quads = model.control.quads;
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    for (Eigen::Index corner = 0; corner < 4; ++corner) {
      const std::int32_t a = quads(corner, q);
      const std::int32_t b = quads((corner + 1) % 4, q);
      ++edges[static_cast<std::size_t>(a)][b];
      ++edges[static_cast<std::size_t>(b)][a];
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t v = 0; v < count; ++v) {
    const auto own = static_cast<int>(v);
    const bool open = edges[v].empty() || std::any_of(edges[v].begin(), edges[v].end(),
                                                      [](const auto& edge) { return edge.second == 1; });
    entries.emplace_back(own, own, open ? 1 : 0.5);
    if (!open) {
      for (const auto& [other, quads_of_edge] : edges[v]) {
        entries.emplace_back(own, other, 0.5 / static_cast<double>(edges[v].size()));
      }
    }
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> once(model.vertex_count(), model.vertex_count());
  once.setFromTriplets(entries.begin(), entries.end());
  const Eigen::SparseMatrix<double, Eigen::RowMajor> twice = once * once;
  mesh::SparseRows rows;
  rows.row_offsets.push_back(0);
  for (Eigen::Index v = 0; v < twice.rows(); ++v) {
    for (Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator entry(twice, v); entry; ++entry) {
      rows.columns.push_back(static_cast<std::int32_t>(entry.col()));
      rows.weights.push_back(static_cast<float>(entry.value()));
    }
    rows.row_offsets.push_back(static_cast<std::int32_t>(rows.columns.size()));
  }
  return rows;
}

FreeSkin free_skin(const face::FaceModel& model) {
  const auto count = static_cast<std::size_t>(model.vertex_count());
  FreeSkin out;
  std::vector<int>& ring = out.ring;
  ring.assign(count, -1);
  for (std::size_t v = 0; v < count; ++v) {
    if (model.control.refinable[v] != 0) {
      ring[v] = 0;
      out.skin.push_back(static_cast<std::int32_t>(v));
    }
  }
  const mesh::Quads& quads = model.control.quads;
  for (int step = 1; step <= kMarginRings; ++step) {
    std::vector<std::int32_t> reached;
    for (Eigen::Index q = 0; q < quads.cols(); ++q) {
      const auto corners = quads.col(q);
      if (std::any_of(corners.begin(), corners.end(), [&](std::int32_t v) {
            const int at = ring[static_cast<std::size_t>(v)];
            return at >= 0 && at < step;
          })) {
        reached.insert(reached.end(), corners.begin(), corners.end());
      }
    }
    for (const std::int32_t v : reached) {
      int& at = ring[static_cast<std::size_t>(v)];
      at = at < 0 ? step : at;
    }
  }
  for (std::size_t v = 0; v < count; ++v) {
    if (ring[v] >= 0) {
      out.free.push_back(static_cast<std::int32_t>(v));
    }
  }
  return out;
}

Eigen::SparseMatrix<double> anchor_matrix(const face::FaceModel& model, const Eigen::Matrix3Xd& control_mm,
                                          const std::vector<std::int32_t>& free, const std::vector<int>& ring,
                                          const AnchorStrength& strength) {
  const auto count = static_cast<Eigen::Index>(model.vertex_count());
  const mesh::Quads& quads = model.control.quads;
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::VectorXd area = Eigen::VectorXd::Zero(count);
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    for (const auto& corners : {std::array{0, 1, 2}, std::array{0, 2, 3}}) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::int32_t a = quads(corners[k], q);
        const std::int32_t b = quads(corners[(k + 1) % 3], q);
        const std::int32_t c = quads(corners[(k + 2) % 3], q);
        const Eigen::Vector3d u = control_mm.col(b) - control_mm.col(a);
        const Eigen::Vector3d v = control_mm.col(c) - control_mm.col(a);
        const double doubled = u.cross(v).norm();
        const double half_cotangent = std::clamp(u.dot(v) / std::max(doubled, kSliver), 0.05, 5.0) / 2;
        area[a] += doubled / 6;
        entries.emplace_back(b, c, -half_cotangent);
        entries.emplace_back(c, b, -half_cotangent);
        entries.emplace_back(b, b, half_cotangent);
        entries.emplace_back(c, c, half_cotangent);
      }
    }
  }
  Sparse stiffness(count, count);
  stiffness.setFromTriplets(entries.begin(), entries.end());
  Sparse onto_free(count, static_cast<Eigen::Index>(free.size()));
  std::vector<Eigen::Triplet<double>> ones;
  Sparse distance(static_cast<Eigen::Index>(free.size()), static_cast<Eigen::Index>(free.size()));
  std::vector<Eigen::Triplet<double>> diagonal;
  for (std::size_t i = 0; i < free.size(); ++i) {
    const auto at = static_cast<int>(i);
    ones.emplace_back(free[i], at, 1);
    const double beyond =
        std::min(1.0, static_cast<double>(ring[static_cast<std::size_t>(free[i])]) / kRimRings);
    diagonal.emplace_back(
        at, at,
        strength.distance * (1 + (kRimStrength - 1) * beyond) * std::max(area[free[i]], kLeastAreaMm2));
  }
  onto_free.setFromTriplets(ones.begin(), ones.end());
  distance.setFromTriplets(diagonal.begin(), diagonal.end());
  const Sparse scaled =
      area.cwiseMax(kLeastAreaMm2).cwiseInverse().asDiagonal() * Sparse(stiffness * onto_free);
  return strength.curvature * Sparse(Sparse((stiffness * onto_free).transpose()) * scaled) + distance;
}

}  // namespace facet::person
