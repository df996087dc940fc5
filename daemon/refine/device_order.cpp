#include "refine/device_order.hpp"

#include <algorithm>
#include <numeric>
#include <utility>

namespace facet::refine {
namespace {

constexpr std::size_t kTile = 1024;
constexpr unsigned kBits = 16;

/// How far along a Hilbert curve through 2^16 x 2^16 cells one lies.
std::uint32_t along_curve(std::uint32_t x, std::uint32_t y) {
  std::uint32_t along = 0;
  for (std::uint32_t side = 1U << (kBits - 1); side > 0; side /= 2) {
    const bool right = (x & side) != 0;
    const bool upper = (y & side) != 0;
    along += side * side * (right ? (upper ? 2U : 3U) : (upper ? 1U : 0U));
    // Each quarter's curve is the whole's, turned.
    if (!upper) {
      if (right) {
        x = ~x;
        y = ~y;
      }
      std::swap(x, y);
    }
  }
  return along;
}

std::vector<std::uint32_t> curve_keys(const mesh::TextureCoordinates& places, std::size_t count) {
  const auto used = places.leftCols(static_cast<Eigen::Index>(count));
  const Eigen::Vector2f low = used.rowwise().minCoeff();
  const float size = std::max((used.rowwise().maxCoeff() - low).maxCoeff(), 1e-6F);
  std::vector<std::uint32_t> out(count);
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector2f cell =
        (used.col(static_cast<Eigen::Index>(i)) - low) * (static_cast<float>((1U << kBits) - 1) / size);
    out[i] = along_curve(static_cast<std::uint32_t>(cell.x()), static_cast<std::uint32_t>(cell.y()));
  }
  return out;
}

}  // namespace

DeviceOrder device_order(const mesh::OneRings& rings, const mesh::TextureCoordinates& places) {
  const std::size_t count = rings.on_boundary.size();
  DeviceOrder out;
  out.host_index.resize(count);
  std::iota(out.host_index.begin(), out.host_index.end(), 0);
  const std::vector<std::uint32_t> keys = curve_keys(places, count);
  const auto key = [&](std::int32_t v) { return keys[static_cast<std::size_t>(v)]; };
  std::ranges::sort(out.host_index, [&](std::int32_t a, std::int32_t b) {
    return std::pair(key(a), a) < std::pair(key(b), b);
  });
  const std::vector<std::int32_t> along = out.host_index;
  const auto groups = [&](std::int32_t v) {
    const auto i = static_cast<std::size_t>(v);
    return (rings.offsets[i + 1] - rings.offsets[i] + 3) / 4;
  };
  for (std::size_t first = 0; first < count; first += kTile) {
    std::stable_sort(out.host_index.begin() + static_cast<std::ptrdiff_t>(first),
                     out.host_index.begin() + static_cast<std::ptrdiff_t>(std::min(first + kTile, count)),
                     [&](std::int32_t a, std::int32_t b) { return groups(a) < groups(b); });
  }
  out.device_index.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    out.device_index[static_cast<std::size_t>(out.host_index[i])] = static_cast<std::int32_t>(i);
  }
  for (const std::int32_t host : along) {
    out.curve.push_back(out.device_index[static_cast<std::size_t>(host)]);
  }
  return out;
}

mesh::OneRings reordered(const mesh::OneRings& rings, const DeviceOrder& order) {
  mesh::OneRings out;
  out.offsets.reserve(rings.offsets.size());
  out.offsets.push_back(0);
  out.neighbours.reserve(rings.neighbours.size());
  for (const std::int32_t host : order.host_index) {
    const auto i = static_cast<std::size_t>(host);
    for (auto k = static_cast<std::size_t>(rings.offsets[i]);
         k < static_cast<std::size_t>(rings.offsets[i + 1]); ++k) {
      out.neighbours.push_back(order.device_index[static_cast<std::size_t>(rings.neighbours[k])]);
    }
    out.offsets.push_back(static_cast<std::int32_t>(out.neighbours.size()));
  }
  out.on_boundary = reordered(rings.on_boundary, order);
  return out;
}

mesh::SparseRows reordered(const mesh::SparseRows& rows, const DeviceOrder& order,
                           const DeviceOrder* columns) {
  mesh::SparseRows out;
  out.row_offsets.reserve(rows.row_offsets.size());
  out.row_offsets.push_back(0);
  out.columns.reserve(rows.columns.size());
  out.weights.reserve(rows.weights.size());
  for (const std::int32_t host : order.host_index) {
    const auto row = static_cast<std::size_t>(host);
    for (auto entry = static_cast<std::size_t>(rows.row_offsets[row]);
         entry < static_cast<std::size_t>(rows.row_offsets[row + 1]); ++entry) {
      const std::int32_t column = rows.columns[entry];
      out.columns.push_back(columns == nullptr ? column
                                               : columns->device_index[static_cast<std::size_t>(column)]);
      out.weights.push_back(rows.weights[entry]);
    }
    out.row_offsets.push_back(static_cast<std::int32_t>(out.columns.size()));
  }
  return out;
}

}  // namespace facet::refine
