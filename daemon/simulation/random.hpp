#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace facet::simulation {

/// A 64-bit mix (splitmix64's finaliser): neighbouring inputs give unrelated outputs.
constexpr std::uint64_t mix(std::uint64_t value) {
  value += 0x9E3779B97F4A7C15ULL;
  value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9ULL;
  value = (value ^ (value >> 27)) * 0x94D049BB133111EBULL;
  return value ^ (value >> 31);
}

/// Random numbers that are the same on every machine and library (std's distributions are not). Each use
/// takes its own `stream` of a seed, so that a change to one does not shift the others. One thread.
class Random {
 public:
  Random(std::uint64_t seed, std::uint64_t stream) : state_(mix(seed) ^ mix(~stream)) {}

  /// 0 <= value < 1.
  float uniform() { return static_cast<float>(mix(state_++) >> 40) * 0x1p-24F; }
  float uniform(float low, float high) { return low + (high - low) * uniform(); }
  /// 0 <= value < count.
  int below(int count) { return static_cast<int>(uniform() * static_cast<float>(count)); }
  /// Standard normal [BM58].
  float normal() {
    const float radius = std::sqrt(-2 * std::log(1 - uniform()));
    return radius * std::cos(2 * std::numbers::pi_v<float> * uniform());
  }

 private:
  std::uint64_t state_;
};

/// Smooth noise in space, about -1 to 1 with mean 0 and period about 1 (gradient noise [Per02]). Any
/// thread.
class Noise {
 public:
  Noise(std::uint64_t seed, std::uint64_t stream) : seed_(mix(seed) ^ mix(stream + 0x6E6F697365ULL)) {}

  float at(const Eigen::Vector3f& point) const;
  /// Octaves of doubled frequency and halved height; the sum is again about -1 to 1.
  float fractal(const Eigen::Vector3f& point, int octaves) const;

 private:
  std::uint64_t seed_;
};

/// 0 below `low`, 1 above `high`, smooth between; low > high turns it round.
inline float smooth_step(float low, float high, float value) {
  const float part = std::fmin(std::fmax((value - low) / (high - low), 0.0F), 1.0F);
  return part * part * (3 - 2 * part);
}

}  // namespace facet::simulation
