#include "mesh/adaptive_surface.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>
#include <utility>

#include "facet/error.hpp"

namespace facet::mesh {

namespace {

std::size_t at(std::int32_t index) {
  return static_cast<std::size_t>(index);
}

std::array<std::int32_t, 3> corners(const Face& face) {
  return {face.apex, face.start, face.end};
}

void check_quads(const Quads& quads, std::int32_t vertex_count) {
  std::unordered_map<std::uint64_t, Eigen::Index> quad_at_edge;
  quad_at_edge.reserve(static_cast<std::size_t>(quads.cols()) * 4);
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    for (Eigen::Index corner = 0; corner < 4; ++corner) {
      const std::int32_t from = quads(corner, q);
      const std::int32_t to = quads((corner + 1) % 4, q);
      if (from < 0 || from >= vertex_count) {
        throw Error(ErrorKind::UnreadableInput,
                    fmt::format("quad {} names vertex {}; the mesh has {}", q, from, vertex_count));
      }
      if (from == to || from == quads((corner + 2) % 4, q)) {
        throw Error(ErrorKind::UnreadableInput, fmt::format("quad {} names vertex {} twice", q, from));
      }
      const std::uint64_t edge = static_cast<std::uint64_t>(from) << 32U |
                                 static_cast<std::uint64_t>(static_cast<std::uint32_t>(to));
      const auto [known, is_new] = quad_at_edge.try_emplace(edge, q);
      if (!is_new) {
        throw Error(
            ErrorKind::UnreadableInput,
            fmt::format("quads {} and {} both run along edge {} to {}: one of them is flipped, or more "
                        "than two quads share the edge",
                        known->second, q, from, to));
      }
    }
  }
}

/// Face mask: the new vertex is the mean of the block's four corners. On the boundary, where the block is a
/// lone face, it is the mid-point of the interior edge.
void add_face_mask(std::int32_t row, const Face& face, const Face* mate,
                   std::vector<Eigen::Triplet<double>>& entries) {
  if (mate == nullptr) {
    entries.emplace_back(row, face.start, 0.5);
    entries.emplace_back(row, face.end, 0.5);
    return;
  }
  for (const std::int32_t corner : {face.apex, face.start, mate->apex, face.end}) {
    entries.emplace_back(row, corner, 0.25);
  }
}

}  // namespace

AdaptiveSurface::AdaptiveSurface(const Quads& quads, Eigen::Matrix2Xf projected_px,
                                 std::vector<std::uint8_t> may_refine)
    : projected_px_(std::move(projected_px)),
      may_refine_(std::move(may_refine)),
      smoothed_level_(may_refine_.size(), -1) {
  check_quads(quads, vertex_count());
  faces_.reserve(static_cast<std::size_t>(quads.cols()) * 2);
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    faces_.push_back({quads(1, q), quads(2, q), quads(0, q), 0});
    faces_.push_back({quads(3, q), quads(0, q), quads(2, q), 0});
  }
  on_boundary_ = build_one_rings(triangles(), vertex_count()).on_boundary;
  group_faces_by_vertex();
}

Triangles AdaptiveSurface::triangles() const {
  Triangles columns(3, static_cast<Eigen::Index>(faces_.size()));
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    columns.col(static_cast<Eigen::Index>(f)) << faces_[f].apex, faces_[f].start, faces_[f].end;
  }
  return columns;
}

AdaptiveSurface::Stencils AdaptiveSurface::bisect_all() {
  return bisect_marked(std::vector<std::uint8_t>(faces_.size(), 1));
}

AdaptiveSurface::Stencils AdaptiveSurface::bisect_larger_than(float min_edge_px) {
  std::vector<std::uint8_t> marked(faces_.size());
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    marked[f] = wants_bisection(faces_[f], min_edge_px) ? 1 : 0;
  }
  return bisect_marked(std::move(marked));
}

bool AdaptiveSurface::wants_bisection(const Face& face, float min_edge_px) const {
  const auto vertices = corners(face);
  const bool allowed = std::all_of(vertices.begin(), vertices.end(),
                                   [&](std::int32_t vertex) { return may_refine_[at(vertex)] != 0; });
  // A length that is NaN is not larger than anything.
  return allowed && (projected_px_.col(face.end) - projected_px_.col(face.start)).norm() > min_edge_px;
}

void AdaptiveSurface::close_marks(std::vector<std::uint8_t>& marked) const {
  std::vector<std::vector<std::int32_t>> marked_of_level;
  const auto put = [&](std::int32_t face) {
    const auto level = at(faces_[at(face)].level);
    if (marked_of_level.size() <= level) {
      marked_of_level.resize(level + 1);
    }
    marked_of_level[level].push_back(face);
  };
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    if (marked[f] != 0) {
      put(static_cast<std::int32_t>(f));
    }
  }
  // adaptVertex [MD19 alg. 1]: before a face is bisected, no face at its interior edge's ends may be of a
  // coarser level; that includes its mate. One bisection is enough: the ends are corners of the bisected
  // parent block, whose own ends had this property one level up.
  for (std::size_t level = marked_of_level.size(); level-- > 0;) {
    for (std::size_t m = 0; m < marked_of_level[level].size(); ++m) {
      const Face& face = faces_[at(marked_of_level[level][m])];
      for (const std::int32_t end : {face.start, face.end}) {
        for (std::int32_t slot = face_offsets_[at(end)]; slot < face_offsets_[at(end) + 1]; ++slot) {
          const std::int32_t other = faces_of_vertex_[at(slot)];
          if (faces_[at(other)].level < face.level && marked[at(other)] == 0) {
            marked[at(other)] = 1;
            put(other);
          }
        }
      }
    }
  }
}

AdaptiveSurface::Stencils AdaptiveSurface::bisect_marked(std::vector<std::uint8_t> marked) {
  close_marks(marked);
  std::vector<std::int32_t> levels;
  for (std::size_t f = 0; f < marked.size(); ++f) {
    if (marked[f] != 0) {
      levels.push_back(faces_[f].level);
    }
  }
  std::sort(levels.begin(), levels.end());
  levels.erase(std::unique(levels.begin(), levels.end()), levels.end());

  Stencils sweep(vertex_count(), vertex_count());
  sweep.setIdentity();
  for (const std::int32_t level : levels) {
    sweep = (bisect_level(level, marked) * sweep).pruned();
  }
  return sweep;
}

AdaptiveSurface::Stencils AdaptiveSurface::bisect_level(std::int32_t level,
                                                        std::vector<std::uint8_t>& marked) {
  // Everything that the masks read is collected before the topology changes.
  const std::int32_t old_count = vertex_count();
  std::vector<Eigen::Triplet<double>> entries;
  std::vector<std::uint8_t> smoothed(at(old_count), 0);
  std::vector<std::pair<std::int32_t, std::int32_t>> blocks;  // a face and its mate, or -1
  for (std::size_t f = 0; f < marked.size(); ++f) {
    const Face& face = faces_[f];
    if (marked[f] == 0 || face.level != level) {
      continue;
    }
    const std::int32_t mate = mate_of(static_cast<std::int32_t>(f));
    const std::int32_t new_vertex = old_count + static_cast<std::int32_t>(blocks.size());
    add_face_mask(new_vertex, face, mate < 0 ? nullptr : &faces_[at(mate)], entries);
    blocks.emplace_back(static_cast<std::int32_t>(f), mate);
    for (const std::int32_t member : {static_cast<std::int32_t>(f), mate}) {
      if (member < 0) {
        continue;
      }
      marked[at(member)] = 0;
      for (const std::int32_t corner : corners(faces_[at(member)])) {
        if (on_boundary_[at(corner)] == 0 && smoothed_level_[at(corner)] < level) {
          smoothed[at(corner)] = 1;
        }
      }
    }
  }
  for (std::int32_t vertex = 0; vertex < old_count; ++vertex) {
    if (smoothed[at(vertex)] != 0) {
      add_vertex_mask(vertex, entries);
      smoothed_level_[at(vertex)] = level;
    } else {
      entries.emplace_back(vertex, vertex, 1.0);
    }
  }

  for (const auto& [first, second] : blocks) {
    const std::int32_t new_vertex = vertex_count();
    const Face& face = faces_[at(first)];
    may_refine_.push_back(may_refine_[at(face.start)] & may_refine_[at(face.end)]);
    on_boundary_.push_back(static_cast<std::uint8_t>(second < 0));
    smoothed_level_.push_back(level);
    for (const std::int32_t member : {first, second}) {
      if (member >= 0) {
        const Face old = faces_[at(member)];
        faces_[at(member)] = {new_vertex, old.apex, old.start, level + 1};
        faces_.push_back({new_vertex, old.end, old.apex, level + 1});
      }
    }
  }

  marked.resize(faces_.size(), 0);

  Stencils stencils(vertex_count(), old_count);
  stencils.setFromTriplets(entries.begin(), entries.end());
  push_projections(stencils);
  group_faces_by_vertex();
  return stencils;
}

void AdaptiveSurface::group_faces_by_vertex() {
  face_offsets_.assign(at(vertex_count()) + 1, 0);
  for (const Face& face : faces_) {
    for (const std::int32_t vertex : corners(face)) {
      ++face_offsets_[at(vertex) + 1];
    }
  }
  for (std::size_t v = 1; v < face_offsets_.size(); ++v) {
    face_offsets_[v] += face_offsets_[v - 1];
  }
  faces_of_vertex_.resize(faces_.size() * 3);
  std::vector<std::int32_t> next(face_offsets_.begin(), face_offsets_.end() - 1);
  for (std::size_t f = 0; f < faces_.size(); ++f) {
    for (const std::int32_t vertex : corners(faces_[f])) {
      faces_of_vertex_[at(next[at(vertex)]++)] = static_cast<std::int32_t>(f);
    }
  }
}

std::int32_t AdaptiveSurface::mate_of(std::int32_t face) const {
  const Face& own = faces_[at(face)];
  for (std::int32_t slot = face_offsets_[at(own.start)]; slot < face_offsets_[at(own.start) + 1]; ++slot) {
    const Face& other = faces_[at(faces_of_vertex_[at(slot)])];
    if (other.start == own.end && other.end == own.start && other.level == own.level) {
      return faces_of_vertex_[at(slot)];
    }
  }
  return -1;
}

/// Vertex mask: half the vertex itself, the other half shared equally by the vertices that the blocks' edges
/// join it to: 1/8 each of four, 1/(2 n) at an irregular vertex where n blocks meet. All faces round the
/// vertex are of one level here, so their legs are those edges.
void AdaptiveSurface::add_vertex_mask(std::int32_t vertex,
                                      std::vector<Eigen::Triplet<double>>& entries) const {
  std::vector<std::int32_t> neighbours;
  for (std::int32_t slot = face_offsets_[at(vertex)]; slot < face_offsets_[at(vertex) + 1]; ++slot) {
    const Face& face = faces_[at(faces_of_vertex_[at(slot)])];
    if (vertex == face.apex) {
      neighbours.push_back(face.start);
      neighbours.push_back(face.end);
    } else {
      neighbours.push_back(face.apex);
    }
  }
  std::sort(neighbours.begin(), neighbours.end());
  neighbours.erase(std::unique(neighbours.begin(), neighbours.end()), neighbours.end());
  entries.emplace_back(vertex, vertex, 0.5);
  for (const std::int32_t neighbour : neighbours) {
    entries.emplace_back(vertex, neighbour, 0.5 / static_cast<double>(neighbours.size()));
  }
}

/// A vertex that no camera sees (NaN) gives nothing to the projections of its neighbours: the other weights
/// of the mask are scaled up, so the unknown region does not grow from sweep to sweep.
void AdaptiveSurface::push_projections(const Stencils& stencils) {
  Eigen::Matrix2Xf pushed(2, stencils.rows());
  for (Eigen::Index row = 0; row < stencils.rows(); ++row) {
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    double weight = 0;
    for (Stencils::InnerIterator entry(stencils, row); entry; ++entry) {
      if (projected_px_.col(entry.col()).allFinite()) {
        sum += entry.value() * projected_px_.col(entry.col()).cast<double>();
        weight += entry.value();
      }
    }
    // 0 / 0 stays NaN: nothing is known here.
    pushed.col(row) = (sum / weight).cast<float>();
  }
  projected_px_ = std::move(pushed);
}

}  // namespace facet::mesh
