#include "mesh/mesh.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "facet/error.hpp"
#include "mesh/quads.hpp"

namespace facet::mesh {

namespace {

/// The two other corners of one triangle at a vertex, in order: triangle (vertex, from, to).
struct Wedge {
  std::int32_t from = 0;
  std::int32_t to = 0;
};

void check_triangles(const Triangles& triangles, std::int32_t vertex_count) {
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto triangle = triangles.col(t);
    if (triangle.minCoeff() < 0 || triangle.maxCoeff() >= vertex_count) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("triangle {} names vertices {}, {}, {}; the mesh has {}", t, triangle[0],
                              triangle[1], triangle[2], vertex_count));
    }
    if (triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0]) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("triangle {} names vertex {} twice", t,
                              triangle[0] == triangle[1] ? triangle[0] : triangle[2]));
    }
  }
}

/// Groups the triangles' wedges by vertex: wedges[offsets[v] .. offsets[v + 1]).
void group_wedges(const Triangles& triangles, std::vector<std::int32_t>& offsets,
                  std::vector<Wedge>& wedges) {
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      ++offsets[static_cast<std::size_t>(triangles(corner, t)) + 1];
    }
  }
  for (std::size_t v = 1; v < offsets.size(); ++v) {
    offsets[v] += offsets[v - 1];
  }
  wedges.resize(static_cast<std::size_t>(offsets.back()));
  std::vector<std::int32_t> next(offsets.begin(), offsets.end() - 1);
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      std::int32_t& slot = next[static_cast<std::size_t>(triangles(corner, t))];
      wedges[static_cast<std::size_t>(slot)] = {triangles((corner + 1) % 3, t),
                                                triangles((corner + 2) % 3, t)};
      ++slot;
    }
  }
}

/// Reorders the wedges [first, last) of one vertex so that each begins where the one before it ends.
/// Returns whether the fan is open (the vertex lies on the boundary).
bool chain_wedges(std::int32_t vertex, Wedge* first, Wedge* last) {
  for (Wedge* wedge = first; wedge != last; ++wedge) {
    const auto same_from = [&](const Wedge& other) { return other.from == wedge->from; };
    const auto same_to = [&](const Wedge& other) { return other.to == wedge->to; };
    const bool twice_out = std::any_of(wedge + 1, last, same_from);
    if (twice_out || std::any_of(wedge + 1, last, same_to)) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("edge {}-{} is used twice in the same direction: a face is flipped, or more "
                              "than two faces share the edge",
                              vertex, twice_out ? wedge->from : wedge->to));
    }
  }
  // An open fan starts at the wedge that none precedes, a closed one anywhere.
  Wedge* start = std::find_if(first, last, [&](const Wedge& wedge) {
    return std::none_of(first, last, [&](const Wedge& other) { return other.to == wedge.from; });
  });
  const bool open = start != last;
  if (open) {
    std::iter_swap(first, start);
  }
  for (Wedge* wedge = first; wedge + 1 != last; ++wedge) {
    Wedge* next = std::find_if(wedge + 1, last, [&](const Wedge& other) { return other.from == wedge->to; });
    if (next == last) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("the faces round vertex {} are not one fan: the surface is pinched there", vertex));
    }
    std::iter_swap(wedge + 1, next);
  }
  return open;
}

}  // namespace

OneRings build_one_rings(const Triangles& triangles, std::int32_t vertex_count) {
  check_triangles(triangles, vertex_count);
  const auto count = static_cast<std::size_t>(vertex_count);
  std::vector<std::int32_t> wedge_offsets(count + 1, 0);
  std::vector<Wedge> wedges;
  group_wedges(triangles, wedge_offsets, wedges);

  OneRings rings;
  rings.offsets.reserve(count + 1);
  rings.offsets.push_back(0);
  rings.neighbours.reserve(wedges.size() + count / 4);
  rings.on_boundary.resize(count);
  for (std::size_t v = 0; v < count; ++v) {
    Wedge* first = wedges.data() + wedge_offsets[v];
    Wedge* last = wedges.data() + wedge_offsets[v + 1];
    if (first == last) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("vertex {} belongs to no face", v));
    }
    const bool open = chain_wedges(static_cast<std::int32_t>(v), first, last);
    for (const Wedge* wedge = first; wedge != last; ++wedge) {
      rings.neighbours.push_back(wedge->from);
    }
    if (open) {
      rings.neighbours.push_back((last - 1)->to);
    }
    rings.on_boundary[v] = open ? 1 : 0;
    rings.offsets.push_back(static_cast<std::int32_t>(rings.neighbours.size()));
  }
  return rings;
}

void vertex_normals(const Vertices& vertices, const Triangles& triangles, Eigen::Matrix3Xf& normals) {
  normals.setZero(3, vertices.cols());
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const std::int32_t i = triangles(0, t);
    const std::int32_t j = triangles(1, t);
    const std::int32_t k = triangles(2, t);
    const Eigen::Vector3f origin = vertices.col(i);
    const Eigen::Vector3f a = vertices.col(j) - origin;
    const Eigen::Vector3f b = vertices.col(k) - origin;
    // Which product of a sum is rounded is said, not left to the compiler: other readers rebuild the same
    // bits.
    const Eigen::Vector3f doubled_area(std::fma(-a.z(), b.y(), a.y() * b.z()),
                                       std::fma(-a.x(), b.z(), a.z() * b.x()),
                                       std::fma(-a.y(), b.x(), a.x() * b.y()));
    normals.col(i) += doubled_area;
    normals.col(j) += doubled_area;
    normals.col(k) += doubled_area;
  }
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const Eigen::Vector3f sum = normals.col(v);
    const float length = std::sqrt(std::fma(sum.x(), sum.x(), std::fma(sum.z(), sum.z(), sum.y() * sum.y())));
    if (length > 0) {
      normals.col(v) /= length;
    }
  }
}

void apply(const SparseRows& stencils, const Eigen::Ref<const Eigen::MatrixXf>& in, Eigen::MatrixXf& out) {
  const std::int32_t row_count = stencils.row_count();
  out.resize(in.rows(), row_count);
  for (std::int32_t row = 0; row < row_count; ++row) {
    auto target = out.col(row);
    target.setZero();
    const std::int32_t end = stencils.row_offsets[static_cast<std::size_t>(row) + 1];
    for (std::int32_t entry = stencils.row_offsets[static_cast<std::size_t>(row)]; entry < end; ++entry) {
      target += stencils.weights[static_cast<std::size_t>(entry)] *
                in.col(stencils.columns[static_cast<std::size_t>(entry)]);
    }
  }
}

void apply(const SparseRows& stencils, const Vertices& in, Vertices& out) {
  const std::int32_t row_count = stencils.row_count();
  out.resize(3, row_count);
  const float* source = in.data();
  float* target = out.data();
  const std::int32_t* columns = stencils.columns.data();
  const float* weights = stencils.weights.data();
  std::int32_t entry = 0;
  for (std::int32_t row = 0; row < row_count; ++row) {
    const std::int32_t end = stencils.row_offsets[static_cast<std::size_t>(row) + 1];
    float x = 0;
    float y = 0;
    float z = 0;
    for (; entry < end; ++entry) {
      const float* from = source + 3 * static_cast<std::ptrdiff_t>(columns[entry]);
      const float weight = weights[entry];
      x = std::fma(weight, from[0], x);
      y = std::fma(weight, from[1], y);
      z = std::fma(weight, from[2], z);
    }
    *target++ = x;
    *target++ = y;
    *target++ = z;
  }
}

Triangles split_quads(const Quads& quads) {
  Triangles triangles(3, 2 * quads.cols());
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    triangles.col(2 * q) << quads(0, q), quads(1, q), quads(2, q);
    triangles.col(2 * q + 1) << quads(0, q), quads(2, q), quads(3, q);
  }
  return triangles;
}

}  // namespace facet::mesh
