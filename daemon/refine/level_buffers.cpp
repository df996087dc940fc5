#include "refine/level_buffers.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <span>

namespace facet::refine {
namespace {

// As in shaders/refine/topology.glsl.
constexpr std::int32_t kFree = 0x10000;
constexpr std::int32_t kClosed = 0x20000;
constexpr int kTrustShift = 20;
constexpr float kFullTrust = 255;
constexpr std::size_t kLanes = 4;
constexpr std::uint32_t kGroupSize = 64;

std::size_t ring_size(const mesh::OneRings& rings, std::size_t vertex) {
  return static_cast<std::size_t>(rings.offsets[vertex + 1] - rings.offsets[vertex]);
}

std::size_t count_groups(const mesh::OneRings& rings) {
  std::size_t groups = 0;
  for (std::size_t v = 0; v < rings.on_boundary.size(); ++v) {
    groups += (ring_size(rings, v) + kLanes - 1) / kLanes;
  }
  return groups;
}

}  // namespace

LevelTopology::LevelTopology(gpu::Context& context, const mesh::OneRings& rings,
                             const std::vector<std::uint8_t>& free, const std::vector<std::int32_t>& curve,
                             const std::vector<float>& trust, std::uint32_t patch_vertices)
    : vertex_count(static_cast<std::uint32_t>(rings.on_boundary.size())),
      group_count(static_cast<std::uint32_t>(count_groups(rings))),
      workgroup_count(std::min(context.info().workgroup_count, gpu::groups_for(vertex_count, kGroupSize))),
      vertex_rings(context, vertex_count, gpu::TexelFormat::Rg32i, "vertex_rings"),
      ring_indices(context, kLanes * group_count, gpu::TexelFormat::R32i, "ring_indices"),
      patches(context, cut_patches(rings, free, curve,
                                   patch_vertices != 0 ? patch_vertices : context.info().patch_vertices,
                                   context.info().patch_places)) {
  std::vector<std::array<std::int32_t, 2>> packed_rings(vertex_count);
  std::vector<std::int32_t> packed_groups(kLanes * group_count, 0);
  std::size_t group = 0;
  for (std::size_t v = 0; v < vertex_count; ++v) {
    const std::size_t size = ring_size(rings, v);
    const bool closed = rings.on_boundary[v] == 0;
    const auto trusted = static_cast<std::int32_t>(std::lround(kFullTrust * (trust.empty() ? 1 : trust[v])));
    packed_rings[v] = {static_cast<std::int32_t>(group),
                       static_cast<std::int32_t>(size) | (closed ? kClosed : 0) |
                           (closed && free[v] != 0 ? kFree : 0) | (trusted << kTrustShift)};
    std::copy_n(rings.neighbours.begin() + rings.offsets[v], size,
                packed_groups.begin() + static_cast<std::ptrdiff_t>(kLanes * group));
    group += (size + kLanes - 1) / kLanes;
  }
  gpu::upload(context, vertex_rings.buffer, std::as_bytes(std::span(packed_rings)));
  gpu::upload(context, ring_indices.buffer, std::as_bytes(std::span(packed_groups)));
}

LevelStencils::LevelStencils(gpu::Context& context, const mesh::SparseRows& rows)
    : stencil_rows(context, static_cast<std::size_t>(rows.row_count()), gpu::TexelFormat::Rg32i,
                   "stencil_rows"),
      stencil_entries(context, rows.columns.size(), gpu::TexelFormat::Rg32i, "stencil_entries") {
  std::vector<std::array<std::int32_t, 2>> packed_rows(static_cast<std::size_t>(rows.row_count()));
  for (std::size_t row = 0; row < packed_rows.size(); ++row) {
    packed_rows[row] = {rows.row_offsets[row], rows.row_offsets[row + 1] - rows.row_offsets[row]};
  }
  std::vector<std::array<std::int32_t, 2>> packed_entries(rows.columns.size());
  for (std::size_t entry = 0; entry < packed_entries.size(); ++entry) {
    packed_entries[entry] = {rows.columns[entry], std::bit_cast<std::int32_t>(rows.weights[entry])};
  }
  gpu::upload(context, stencil_rows.buffer, std::as_bytes(std::span(packed_rows)));
  gpu::upload(context, stencil_entries.buffer, std::as_bytes(std::span(packed_entries)));
}

LevelState::LevelState(gpu::Context& context, std::uint32_t vertex_count)
    : positions(context, vertex_count, gpu::TexelFormat::Rgba32f, "positions"),
      normals(context, vertex_count, gpu::TexelFormat::Rgba32f, "normals"),
      colours(context, vertex_count, gpu::TexelFormat::Rgba32f, "colours"),
      albedo(context, vertex_count, gpu::TexelFormat::Rgba32f, "albedo"),
      irradiance(context, vertex_count, gpu::TexelFormat::Rgba32f, "irradiance"),
      priors(context, vertex_count, gpu::TexelFormat::R32f, "priors"),
      reliefs(context, vertex_count, gpu::TexelFormat::Rgba32f, "reliefs") {
  clear(context, {&positions.buffer, &normals.buffer, &colours.buffer, &albedo.buffer, &irradiance.buffer,
                  &priors.buffer, &reliefs.buffer});
}

std::vector<std::vector<std::uint8_t>> free_vertices(const mesh::Hierarchy& hierarchy,
                                                     const std::vector<std::uint8_t>& refinable) {
  constexpr float kMostlyRefinable = 0.75F;
  std::vector<std::vector<std::uint8_t>> out;
  std::vector<float> share(refinable.begin(), refinable.end());
  for (const mesh::Level& level : hierarchy.levels) {
    std::vector<float> finer(static_cast<std::size_t>(level.vertex_count), 0.0F);
    std::vector<std::uint8_t>& free = out.emplace_back(finer.size(), std::uint8_t{0});
    const mesh::SparseRows& rows = level.from_coarser;
    for (std::size_t v = 0; v < finer.size(); ++v) {
      for (auto entry = static_cast<std::size_t>(rows.row_offsets[v]);
           entry < static_cast<std::size_t>(rows.row_offsets[v + 1]); ++entry) {
        finer[v] += rows.weights[entry] * share[static_cast<std::size_t>(rows.columns[entry])];
      }
      free[v] = level.one_rings.on_boundary[v] == 0 && finer[v] >= kMostlyRefinable ? 1 : 0;
    }
    share = std::move(finer);
  }
  return out;
}

std::vector<std::vector<float>> trust_of_levels(const mesh::Hierarchy& hierarchy,
                                                const std::vector<float>& trust) {
  std::vector<std::vector<float>> out(hierarchy.levels.size());
  if (trust.empty()) {
    return out;
  }
  Eigen::MatrixXf coarser = Eigen::Map<const Eigen::RowVectorXf>(trust.data(), std::ssize(trust));
  Eigen::MatrixXf finer;
  for (std::size_t l = 0; l < out.size(); ++l) {
    mesh::apply(hierarchy.levels[l].from_coarser, coarser, finer);
    finer = finer.cwiseMax(0).cwiseMin(1);
    out[l].assign(finer.data(), finer.data() + finer.size());
    coarser.swap(finer);
  }
  return out;
}

}  // namespace facet::refine
