#include "simulation/random.hpp"

#include <array>

namespace facet::simulation {
namespace {

constexpr float kHeight = 1.6F;  // brings the usual extremes of three-dimensional gradient noise to +-1

float fade(float t) {
  return t * t * t * (t * (t * 6 - 15) + 10);
}

/// Dot product of `offset` with one of the 12 directions to a cube's edges.
float gradient(std::uint64_t hash, const Eigen::Vector3f& offset) {
  const auto pick = static_cast<int>(hash % 12);
  const int first = pick / 4 == 0 ? 1 : 0;
  const int second = pick / 4 == 2 ? 1 : 2;
  return ((pick & 1) != 0 ? -offset[first] : offset[first]) +
         ((pick & 2) != 0 ? -offset[second] : offset[second]);
}

}  // namespace

float Noise::at(const Eigen::Vector3f& point) const {
  const Eigen::Vector3f floor = point.array().floor();
  const Eigen::Vector3f part = point - floor;
  const Eigen::Vector3f weight{fade(part.x()), fade(part.y()), fade(part.z())};
  float sum = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3f step(static_cast<float>(corner & 1), static_cast<float>((corner >> 1) & 1),
                               static_cast<float>((corner >> 2) & 1));
    std::uint64_t hash = seed_;
    float share = 1;
    for (int axis = 0; axis < 3; ++axis) {
      hash = mix(hash ^ static_cast<std::uint64_t>(static_cast<std::int64_t>(floor[axis] + step[axis])));
      share *= step[axis] > 0 ? weight[axis] : 1 - weight[axis];
    }
    sum += share * gradient(hash, part - step);
  }
  return kHeight * sum;
}

float Noise::fractal(const Eigen::Vector3f& point, int octaves) const {
  float sum = 0;
  float height = 1;
  float total = 0;
  Eigen::Vector3f scaled = point;
  for (int octave = 0; octave < octaves; ++octave) {
    sum += height * at(scaled);
    total += height * height;
    height *= 0.5F;
    scaled = 2.03F * scaled + Eigen::Vector3f(17.3F, -5.1F, 9.7F);
  }
  return sum / std::sqrt(total);
}

}  // namespace facet::simulation
