#include <algorithm>
#include <map>
#include <numeric>

#include "exports/export_sequence.hpp"

namespace facet::exports {
namespace {

/// [vertex_count] the first vertex of the piece that a vertex is of.
std::vector<std::int32_t> pieces_of(const mesh::Triangles& triangles, Eigen::Index vertex_count) {
  std::vector<std::int32_t> first(static_cast<std::size_t>(vertex_count));
  std::iota(first.begin(), first.end(), 0);
  const auto root = [&first](std::int32_t vertex) {
    while (first[static_cast<std::size_t>(vertex)] != vertex) {
      std::int32_t& above = first[static_cast<std::size_t>(vertex)];
      above = first[static_cast<std::size_t>(above)];
      vertex = above;
    }
    return vertex;
  };
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    for (int corner = 1; corner < 3; ++corner) {
      const auto [low, high] = std::minmax({root(triangles(0, t)), root(triangles(corner, t))});
      first[static_cast<std::size_t>(high)] = low;
    }
  }
  for (std::int32_t& vertex : first) {
    vertex = root(vertex);
  }
  return first;
}

}  // namespace

std::array<std::vector<std::int32_t>, 2> find_eyeballs(const mesh::Vertices& vertices_mm,
                                                       const mesh::Triangles& triangles,
                                                       std::span<const std::uint8_t> is_eye) {
  const std::vector<std::int32_t> piece_of = pieces_of(triangles, vertices_mm.cols());
  std::map<std::int32_t, std::vector<std::int32_t>> pieces;
  for (std::size_t v = 0; v < piece_of.size(); ++v) {
    pieces[piece_of[v]].push_back(static_cast<std::int32_t>(v));
  }
  std::array<std::vector<std::int32_t>, 2> eyeballs;
  for (auto& [first, vertices] : pieces) {
    const auto known = [&](std::int32_t v) { return static_cast<std::size_t>(v) < is_eye.size(); };
    const bool eye =
        known(vertices.front()) && std::all_of(vertices.begin(), vertices.end(), [&](std::int32_t v) {
          return !known(v) || is_eye[static_cast<std::size_t>(v)] != 0;
        });
    if (eye && vertices.size() > 3) {
      const bool left = vertices_mm(Eigen::all, vertices).row(0).mean() > 0;
      std::vector<std::int32_t>& place = eyeballs.at(left ? 0 : 1);
      if (vertices.size() > place.size()) {
        place = std::move(vertices);
      }
    }
  }
  return eyeballs;
}

ExportMesh neutral_mesh(const ExpressionShapes& shapes, const ExportMesh& mesh) {
  ExportMesh out = mesh;
  out.vertices_mm = shapes.neutral_mm;
  mesh::vertex_normals(out.vertices_mm, out.triangles, out.normals);
  mend_normals(out.normals);
  return out;
}

}  // namespace facet::exports
