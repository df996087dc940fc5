#include "mesh/hierarchy.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <utility>

#include "facet/assert.hpp"
#include "facet/error.hpp"
#include "mesh/adaptive_surface.hpp"

namespace facet::mesh {

namespace {

/// A level costs a whole solve, so one that adds fewer vertices than this is folded into the level below.
constexpr float kLeastGrowth = 1.1F;

/// FNV-1a, 64 bit: the id must not depend on the machine or the library version.
class ContentHash {
 public:
  template <typename Value>
  void add(const Value* values, std::size_t count) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(values);
    for (std::size_t i = 0; i < count * sizeof(Value); ++i) {
      state_ = (state_ ^ bytes[i]) * kPrime;
    }
  }
  std::uint64_t value() const { return state_; }

 private:
  static constexpr std::uint64_t kPrime = 0x100000001b3;
  std::uint64_t state_ = 0xcbf29ce484222325;
};

bool same_rows(const SparseRows& a, const SparseRows& b) {
  return a.row_offsets == b.row_offsets && a.columns == b.columns && a.weights == b.weights;
}

bool same_level(const Level& a, const Level& b) {
  return a.vertex_count == b.vertex_count && a.triangles.cols() == b.triangles.cols() &&
         a.triangles == b.triangles && same_rows(a.from_coarser, b.from_coarser);
}

SparseRows to_rows(const AdaptiveSurface::Stencils& stencils) {
  SparseRows rows;
  rows.row_offsets.reserve(static_cast<std::size_t>(stencils.rows()) + 1);
  rows.columns.reserve(static_cast<std::size_t>(stencils.nonZeros()));
  rows.weights.reserve(static_cast<std::size_t>(stencils.nonZeros()));
  rows.row_offsets.push_back(0);
  for (Eigen::Index row = 0; row < stencils.rows(); ++row) {
    for (AdaptiveSurface::Stencils::InnerIterator entry(stencils, row); entry; ++entry) {
      rows.columns.push_back(static_cast<std::int32_t>(entry.col()));
      rows.weights.push_back(static_cast<float>(entry.value()));
    }
    rows.row_offsets.push_back(static_cast<std::int32_t>(rows.columns.size()));
  }
  return rows;
}

Level make_level(const AdaptiveSurface& surface, const AdaptiveSurface::Stencils& stencils) {
  Level level;
  level.vertex_count = surface.vertex_count();
  level.triangles = surface.triangles();
  level.from_coarser = to_rows(stencils);
  level.one_rings = build_one_rings(level.triangles, level.vertex_count);
  FACET_ASSERT(level.from_coarser.row_offsets.size() == static_cast<std::size_t>(level.vertex_count) + 1,
               level.from_coarser.row_offsets.size(), level.vertex_count);
  FACET_ASSERT(level.triangles.maxCoeff() < level.vertex_count, level.triangles.maxCoeff(),
               level.vertex_count);
  return level;
}

/// One adaptive sweep; nothing where no block is left to bisect or the result would pass max_vertices.
std::optional<AdaptiveSurface::Stencils> sweep(AdaptiveSurface& surface, const HierarchyOptions& options) {
  AdaptiveSurface next = surface;
  AdaptiveSurface::Stencils stencils = next.bisect_larger_than(options.min_edge_px);
  if (next.vertex_count() == surface.vertex_count() || next.vertex_count() > options.max_vertices) {
    return std::nullopt;
  }
  FACET_ASSERT(stencils.rows() == next.vertex_count() && stencils.cols() == surface.vertex_count(),
               stencils.rows(), stencils.cols(), next.vertex_count(), surface.vertex_count());
  surface = std::move(next);
  return stencils;
}

/// Texture coordinates of the control mesh to those of the finest level, and the id.
void complete(Hierarchy& hierarchy) {
  Eigen::MatrixXf texture_coordinates = hierarchy.texture_coordinates;
  for (const Level& level : hierarchy.levels) {
    Eigen::MatrixXf finer;
    apply(level.from_coarser, texture_coordinates, finer);
    texture_coordinates = std::move(finer);
  }
  FACET_ASSERT(texture_coordinates.cols() == hierarchy.finest().vertex_count, texture_coordinates.cols(),
               hierarchy.finest().vertex_count);
  hierarchy.texture_coordinates = texture_coordinates;
  hierarchy.id = topology_id(hierarchy);
}

void check(const ControlMesh& control, const TextureCoordinates& control_px,
           const std::vector<std::uint8_t>& facing, const HierarchyOptions& options) {
  if (control.quads.cols() == 0) {
    throw Error(ErrorKind::UnreadableInput, "the control mesh has no quads");
  }
  const auto need = [&](const char* what, std::size_t found) {
    if (found != static_cast<std::size_t>(control.vertex_count)) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("{} of {} vertices given for a control mesh of {}",
                                                          what, found, control.vertex_count));
    }
  };
  need("texture coordinates", static_cast<std::size_t>(control.texture_coordinates.cols()));
  need("refinable flags", control.refinable.size());
  need("projections", static_cast<std::size_t>(control_px.cols()));
  need("facing flags", facing.size());
  if (options.max_levels < 1 || !(options.min_edge_px > 0)) {
    throw Error(ErrorKind::Usage,
                fmt::format("a hierarchy needs max_levels >= 1 and min_edge_px > 0, not {} and {}",
                            options.max_levels, options.min_edge_px));
  }
}

}  // namespace

std::uint64_t topology_id(const Hierarchy& hierarchy) {
  ContentHash content;
  content.add(&hierarchy.control_vertex_count, 1);
  for (const Level& level : hierarchy.levels) {
    content.add(&level.vertex_count, 1);
    content.add(level.triangles.data(), static_cast<std::size_t>(level.triangles.size()));
    content.add(level.from_coarser.row_offsets.data(), level.from_coarser.row_offsets.size());
    content.add(level.from_coarser.columns.data(), level.from_coarser.columns.size());
    content.add(level.from_coarser.weights.data(), level.from_coarser.weights.size());
  }
  return content.value() != 0 ? content.value() : 1;
}

bool same_topology(const Hierarchy& a, const Hierarchy& b) {
  return &a == &b ||
         (a.id == b.id && a.control_vertex_count == b.control_vertex_count &&
          std::equal(a.levels.begin(), a.levels.end(), b.levels.begin(), b.levels.end(), same_level));
}

std::shared_ptr<const Hierarchy> build_hierarchy(const ControlMesh& control,
                                                 const TextureCoordinates& control_px,
                                                 const std::vector<std::uint8_t>& facing,
                                                 const HierarchyOptions& options) {
  check(control, control_px, facing, options);
  std::vector<std::uint8_t> may_refine(facing.size());
  for (std::size_t v = 0; v < facing.size(); ++v) {
    const bool projected = control_px.col(static_cast<Eigen::Index>(v)).allFinite();
    may_refine[v] = control.refinable[v] != 0 && facing[v] != 0 && projected ? 1 : 0;
  }

  auto hierarchy = std::make_shared<Hierarchy>();
  hierarchy->control_vertex_count = control.vertex_count;
  AdaptiveSurface surface(control.quads, control_px, std::move(may_refine));
  AdaptiveSurface::Stencils stencils = surface.bisect_all();
  hierarchy->levels.push_back(make_level(surface, stencils));
  while (static_cast<int>(hierarchy->levels.size()) < options.max_levels) {
    const auto first = sweep(surface, options);
    if (!first) {
      break;
    }
    const auto second = sweep(surface, options);
    const AdaptiveSurface::Stencils added =
        second ? AdaptiveSurface::Stencils((*second * *first).pruned()) : *first;
    const auto least_count =
        static_cast<std::int32_t>(kLeastGrowth * static_cast<float>(hierarchy->finest().vertex_count));
    if (hierarchy->levels.size() > 1 && surface.vertex_count() < least_count) {
      stencils = (added * stencils).pruned();
      hierarchy->levels.back() = make_level(surface, stencils);
      continue;
    }
    stencils = added;
    hierarchy->levels.push_back(make_level(surface, stencils));
  }

  hierarchy->texture_coordinates = control.texture_coordinates;
  complete(*hierarchy);
  return hierarchy;
}

std::shared_ptr<const Hierarchy> build_hierarchy_below(const ControlMesh& control,
                                                       std::int32_t coarse_vertex_count, int sweeps) {
  const auto count = static_cast<std::size_t>(control.vertex_count);
  const TextureCoordinates nowhere_px = TextureCoordinates::Zero(2, control.vertex_count);
  check(control, nowhere_px, std::vector<std::uint8_t>(count, 1), {});
  AdaptiveSurface surface(control.quads, nowhere_px, control.refinable);
  AdaptiveSurface::Stencils stencils = surface.bisect_all();
  while (surface.vertex_count() < coarse_vertex_count) {
    stencils = (surface.bisect_all() * stencils).pruned();
  }
  if (surface.vertex_count() != coarse_vertex_count || sweeps < 1) {
    throw Error(ErrorKind::Usage,
                fmt::format("no whole sweeps of the control mesh give {} vertices, or {} further sweeps make "
                            "no sense",
                            coarse_vertex_count, sweeps));
  }
  auto hierarchy = std::make_shared<Hierarchy>();
  hierarchy->control_vertex_count = coarse_vertex_count;
  AdaptiveSurface::Stencils own(coarse_vertex_count, coarse_vertex_count);
  own.setIdentity();
  hierarchy->levels.push_back(make_level(surface, own));
  Eigen::MatrixXf texture_coordinates;
  apply(to_rows(stencils), Eigen::MatrixXf(control.texture_coordinates), texture_coordinates);
  hierarchy->texture_coordinates = texture_coordinates;
  AdaptiveSurface::Stencils further = own;
  constexpr float kWhateverItsLengthPx = -1;
  for (int i = 0; i < sweeps; ++i) {
    further = (surface.bisect_larger_than(kWhateverItsLengthPx) * further).pruned();
  }
  hierarchy->levels.push_back(make_level(surface, further));
  complete(*hierarchy);
  return hierarchy;
}

void push_positions(const Hierarchy& hierarchy, const Vertices& control, std::vector<Vertices>& out) {
  FACET_ASSERT(control.cols() == hierarchy.control_vertex_count, control.cols(),
               hierarchy.control_vertex_count);
  out.resize(hierarchy.levels.size());
  const Vertices* coarser = &control;
  for (std::size_t l = 0; l < hierarchy.levels.size(); ++l) {
    apply(hierarchy.levels[l].from_coarser, *coarser, out[l]);
    coarser = &out[l];
  }
}

void rebuild_finest(const Hierarchy& hierarchy, const Vertices& control_mm,
                    const std::vector<float>& displacements_mm, Vertices& vertices_mm,
                    Eigen::Matrix3Xf& normals) {
  FACET_ASSERT(control_mm.cols() == hierarchy.control_vertex_count, control_mm.cols(),
               hierarchy.control_vertex_count);
  FACET_ASSERT(
      displacements_mm.empty() || std::cmp_equal(displacements_mm.size(), hierarchy.finest().vertex_count),
      displacements_mm.size(), hierarchy.finest().vertex_count);
  Vertices coarser = control_mm;
  for (const Level& level : hierarchy.levels) {
    apply(level.from_coarser, coarser, vertices_mm);
    coarser = vertices_mm;
  }
  const Triangles& triangles = hierarchy.finest().triangles;
  vertex_normals(vertices_mm, triangles, normals);
  if (displacements_mm.empty()) {
    return;
  }
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const float displacement_mm = displacements_mm[static_cast<std::size_t>(v)];
    for (Eigen::Index i = 0; i < 3; ++i) {
      vertices_mm(i, v) = std::fma(normals(i, v), displacement_mm, vertices_mm(i, v));
    }
  }
  vertex_normals(vertices_mm, triangles, normals);
}

}  // namespace facet::mesh
