#include "studio/region_colours.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace facet::studio {
namespace {

/// A hue for each region, far from its neighbours' (golden angle), sRGB.
std::array<std::uint8_t, 3> colour_of(std::size_t region) {
  const double hue = std::fmod(0.02 + 0.381966 * static_cast<double>(region), 1.0);
  std::array<std::uint8_t, 3> out{};
  for (std::size_t channel = 0; channel < 3; ++channel) {
    const double shifted = std::fmod(hue + (channel == 0 ? 0.0 : channel == 1 ? 2.0 / 3 : 1.0 / 3), 1.0) * 6;
    const double part = std::clamp(std::abs(shifted - 3) - 1, 0.0, 1.0);
    out[channel] = static_cast<std::uint8_t>(std::lround(255 * (0.25 + 0.7 * part)));
  }
  return out;
}

}  // namespace

RegionColours colours_of(const animate::InfluenceMaps& maps) {
  RegionColours out;
  if (maps.vertices().empty()) {
    return out;
  }
  out.vertices = maps.vertices();
  for (std::size_t region = 0; region < out.vertices.size(); ++region) {
    out.colours.push_back(colour_of(maps.region_count() == 1 ? 0 : region));
  }
  const animate::RegionWeights& weights = maps.finest();
  const std::size_t count = weights.offsets.size() - 1;
  out.rgb.resize(3 * count);
  for (std::size_t v = 0; v < count; ++v) {
    Eigen::Vector3f mixed = Eigen::Vector3f::Zero();
    for (std::int32_t k = weights.offsets[v]; k < weights.offsets[v + 1]; ++k) {
      const auto entry = static_cast<std::size_t>(k);
      const auto colour = colour_of(weights.regions[entry]);
      mixed += weights.weights[entry] * Eigen::Vector3f(colour[0], colour[1], colour[2]);
    }
    for (std::size_t channel = 0; channel < 3; ++channel) {
      out.rgb[3 * v + channel] = static_cast<std::uint8_t>(
          std::lround(std::clamp(mixed[static_cast<Eigen::Index>(channel)], 0.0F, 255.0F)));
    }
  }
  return out;
}

}  // namespace facet::studio
