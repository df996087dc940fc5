#pragma once

// Private to this room: in which order a level's vertices stand on the device.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/hierarchy.hpp"

namespace facet::refine {

/// A level's vertices as the device holds them: neighbours near each other in memory, for caches, and of
/// like rings, for lanes. Everything that leaves the device is in the hierarchy's own order.
struct DeviceOrder {
  std::vector<std::int32_t> host_index;    ///< [device index] of the hierarchy's level
  std::vector<std::int32_t> device_index;  ///< [index in the hierarchy's level]
  std::vector<std::int32_t> curve;         ///< device indices along the curve
};

/// Tiles of 1,024 vertices along a Hilbert curve through the texture coordinates; within a tile those whose
/// rings take as many groups of four stand together, so that the lanes of a workgroup end together.
///
/// places  [2][at least as many columns as the level has vertices]
DeviceOrder device_order(const mesh::OneRings& rings, const mesh::TextureCoordinates& places);

/// The rings of the vertices in device order, which name their neighbours by device indices.
mesh::OneRings reordered(const mesh::OneRings& rings, const DeviceOrder& order);

/// The rows in device order.
/// columns  of the coarser level; nullptr: these are the control vertices, which keep their order
mesh::SparseRows reordered(const mesh::SparseRows& rows, const DeviceOrder& order,
                           const DeviceOrder* columns);

/// values [vertex_count] in device order; empty stays empty.
template <typename T>
std::vector<T> reordered(const std::vector<T>& values, const DeviceOrder& order) {
  std::vector<T> out(values.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = values[static_cast<std::size_t>(order.host_index[i])];
  }
  return out;
}

}  // namespace facet::refine
