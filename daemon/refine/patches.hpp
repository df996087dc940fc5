#pragma once

// Private to this room: the patches that shaders/refine/solve_patches.comp solves.

#include <array>
#include <cstdint>
#include <vector>

#include "gpu/device_array.hpp"
#include "mesh/mesh.hpp"

namespace facet::refine {

/// A level's free vertices in patches, each with two rings of free vertices around it that are solved with it
/// and one more of any kind whose residuals depend on those. Twice: the second set's borders lie in the
/// middle of the first one's patches.
struct PatchLists {
  using Row = std::array<std::int32_t, 4>;
  /// Patches that stand one behind the other.
  struct Set {
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    std::int32_t first_record = 0;
  };

  std::array<Set, 2> sets;
  std::vector<Row> patches;  ///< first record; records that are the patch's own, that are solved, in all
  std::vector<Row> records;  ///< vertex, first group of its ring, of the record's own ring, ring size
  std::vector<Row> groups;   ///< places of four neighbours in the patch: its records from 1 on, 0 is nobody
  std::uint32_t place_count = 0;  ///< of all patches of the larger set
};

/// rings        as the device has them; free [vertex_count] as LevelTopology takes them
/// curve        DeviceOrder::curve: patches are pieces of it
/// most         vertices of a patch of its own
/// most_places  of a patch, its records and one; 0: any number. Smaller patches are cut where they take more
/// Throws Error(NoDevice) where the smallest ones still do.
PatchLists cut_patches(const mesh::OneRings& rings, const std::vector<std::uint8_t>& free,
                       const std::vector<std::int32_t>& curve, std::uint32_t most,
                       std::uint32_t most_places = 0);

/// PatchLists on the device.
struct LevelPatches {
  LevelPatches(gpu::Context& context, const PatchLists& lists);

  /// Of a Gauss-Newton step: by turns.
  const PatchLists::Set& set(int step) const { return sets[static_cast<std::size_t>(step) % sets.size()]; }

  std::array<PatchLists::Set, 2> sets;
  std::uint32_t place_count;
  gpu::DeviceArray patches;
  gpu::DeviceArray vertices;  ///< records
  gpu::DeviceArray groups;
};

}  // namespace facet::refine
