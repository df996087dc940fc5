#include "refine/patches.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <span>
#include <utility>

#include "facet/error.hpp"

namespace facet::refine {
namespace {

constexpr int kHaloRings = 2;

using Row = PatchLists::Row;

/// Adds patches to lists that end up on the device.
class PatchCutter {
 public:
  PatchCutter(const mesh::OneRings& rings, const std::vector<std::uint8_t>& free)
      : rings_(rings), free_(free), places_(free.size(), 0), first_groups_(free.size()) {
    std::int32_t groups = 0;
    for (std::size_t v = 0; v < free.size(); ++v) {
      first_groups_[v] = groups;
      groups += group_count(v);
    }
  }

  /// order  free vertices along the curve
  PatchLists cut(const std::vector<std::int32_t>& order, std::uint32_t most) {
    lists_ = {};
    const std::size_t count = std::max<std::size_t>(1, (order.size() + most - 1) / most);
    for (std::size_t s = 0; s < lists_.sets.size(); ++s) {
      PatchLists::Set& set = lists_.sets[s];
      set.first = static_cast<std::uint32_t>(lists_.patches.size());
      set.first_record = static_cast<std::int32_t>(lists_.records.size());
      // In the second set the first patch and the last are half ones.
      const std::size_t shifted = s == 0 || count == 1 ? 0 : 1;
      set.count = static_cast<std::uint32_t>(count + shifted);
      const auto begin_of = [&](std::size_t patch) {
        const std::size_t halves = std::clamp<std::size_t>(2 * patch, shifted, 2 * count + shifted) - shifted;
        return order.size() * halves / (2 * count);
      };
      for (std::size_t patch = 0; patch < set.count; ++patch) {
        add(std::span(order).subspan(begin_of(patch), begin_of(patch + 1) - begin_of(patch)));
      }
      const auto records =
          static_cast<std::uint32_t>(lists_.records.size()) - static_cast<std::uint32_t>(set.first_record);
      lists_.place_count = std::max(lists_.place_count, records + set.count);
    }
    return std::move(lists_);
  }

 private:
  void add(std::span<const std::int32_t> own) {
    std::vector<std::int32_t> members(own.begin(), own.end());
    sort_for_lanes(members);
    for (const std::int32_t v : members) {
      places_[static_cast<std::size_t>(v)] = -1;
    }
    std::size_t ring_begin = 0;
    for (int ring = 0; ring < kHaloRings; ++ring) {
      ring_begin = add_ring(members, ring_begin, true);
    }
    const std::size_t solved = members.size();
    add_ring(members, 0, false);

    const auto first = static_cast<std::int32_t>(lists_.records.size());
    for (std::size_t k = 0; k < members.size(); ++k) {
      places_[static_cast<std::size_t>(members[k])] = static_cast<std::int32_t>(k) + 1;
    }
    for (const std::int32_t v : members) {
      add_record(static_cast<std::size_t>(v));
    }
    lists_.patches.push_back({first, static_cast<std::int32_t>(own.size()), static_cast<std::int32_t>(solved),
                              static_cast<std::int32_t>(members.size())});
    for (const std::int32_t v : members) {
      places_[static_cast<std::size_t>(v)] = 0;
    }
  }

  std::int32_t group_count(std::size_t v) const {
    return (rings_.offsets[v + 1] - rings_.offsets[v] + 3) / 4;
  }

  std::span<const std::int32_t> ring(std::size_t v) const {
    return std::span(rings_.neighbours)
        .subspan(static_cast<std::size_t>(rings_.offsets[v]),
                 static_cast<std::size_t>(rings_.offsets[v + 1] - rings_.offsets[v]));
  }

  /// Adds the neighbours of the members from `begin` on, in their order in memory. Returns where they begin.
  std::size_t add_ring(std::vector<std::int32_t>& members, std::size_t begin, bool free_alone) {
    const std::size_t end = members.size();
    for (std::size_t k = begin; k < end; ++k) {
      for (const std::int32_t j : ring(static_cast<std::size_t>(members[k]))) {
        const auto v = static_cast<std::size_t>(j);
        if (places_[v] == 0 && (!free_alone || free_[v] != 0)) {
          places_[v] = -1;
          members.push_back(j);
        }
      }
    }
    sort_for_lanes(std::span(members).subspan(end));
    return end;
  }

  /// Rings that take as many groups stand together, so that the lanes of a workgroup end together.
  void sort_for_lanes(std::span<std::int32_t> members) const {
    const auto key = [&](std::int32_t v) { return std::pair(group_count(static_cast<std::size_t>(v)), v); };
    std::ranges::sort(members, [&](std::int32_t a, std::int32_t b) { return key(a) < key(b); });
  }

  /// places_ must hold those of the patch.
  void add_record(std::size_t v) {
    const std::span<const std::int32_t> neighbours = ring(v);
    lists_.records.push_back({static_cast<std::int32_t>(v), first_groups_[v],
                              static_cast<std::int32_t>(lists_.groups.size()),
                              static_cast<std::int32_t>(neighbours.size())});
    for (std::size_t k = 0; k < neighbours.size(); k += 4) {
      Row& group = lists_.groups.emplace_back(Row{0, 0, 0, 0});
      for (std::size_t lane = 0; lane < std::min<std::size_t>(4, neighbours.size() - k); ++lane) {
        group[lane] = places_[static_cast<std::size_t>(neighbours[k + lane])];
      }
    }
  }

  const mesh::OneRings& rings_;
  const std::vector<std::uint8_t>& free_;
  PatchLists lists_;
  std::vector<std::int32_t> places_;        ///< of the patch's members; 0 of all others
  std::vector<std::int32_t> first_groups_;  ///< [vertex_count] among all rings'
};

}  // namespace

PatchLists cut_patches(const mesh::OneRings& rings, const std::vector<std::uint8_t>& free,
                       const std::vector<std::int32_t>& curve, std::uint32_t most,
                       std::uint32_t most_places) {
  constexpr std::uint32_t kLeast = 16;  // a smaller patch is all halo
  std::vector<std::uint8_t> movable(free.size());
  for (std::size_t v = 0; v < free.size(); ++v) {
    movable[v] = free[v] != 0 && rings.on_boundary[v] == 0 ? 1 : 0;
  }
  std::vector<std::int32_t> order;
  std::ranges::copy_if(curve, std::back_inserter(order),
                       [&](std::int32_t v) { return movable[static_cast<std::size_t>(v)] != 0; });
  PatchCutter cutter(rings, movable);
  for (;; most = std::max(kLeast, most * 3 / 4)) {
    PatchLists lists = cutter.cut(order, most);
    const auto records = static_cast<std::uint32_t>(
        std::ranges::max(lists.patches, {}, [](const Row& patch) { return patch[3]; })[3]);
    if (most_places == 0 || records < most_places) {
      return lists;
    }
    if (most <= kLeast) {
      throw Error(ErrorKind::NoDevice,
                  fmt::format("a patch of {} vertices takes {} places, the device has {}", most, records + 1,
                              most_places));
    }
  }
}

namespace {

gpu::DeviceArray on_device(gpu::Context& context, const std::vector<Row>& rows, const char* name) {
  gpu::DeviceArray array(context, std::max<std::size_t>(1, rows.size()), gpu::TexelFormat::Rgba32i, name);
  if (!rows.empty()) {
    gpu::upload(context, array.buffer, std::as_bytes(std::span(rows)));
  }
  return array;
}

}  // namespace

LevelPatches::LevelPatches(gpu::Context& context, const PatchLists& lists)
    : sets(lists.sets),
      place_count(lists.place_count),
      patches(on_device(context, lists.patches, "patches")),
      vertices(on_device(context, lists.records, "patch vertices")),
      groups(on_device(context, lists.groups, "patch groups")) {}

}  // namespace facet::refine
