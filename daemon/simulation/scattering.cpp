#include "simulation/scattering.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "render/renderer.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

/// Bound of the Laplacian's spectrum, 1/mm^2: vertices with less area than this allows count as larger.
constexpr float kSpectrum = 60;

/// A vertex pair's conductance from one of its triangles: half the cotangent of the opposite angle.
float half_cotangent(const Vector3f& one, const Vector3f& other) {
  return 0.5F * one.dot(other) / std::max(one.cross(other).norm(), 1e-9F);
}

/// The Chebyshev coefficients of exp(-t A) for a spectrum of A from 0 to kSpectrum, by channel, summed over
/// the bells: e^-z (2 - [k = 0]) (-1)^k I_k(z) with z = t kSpectrum / 2 and t half the bell's variance.
std::vector<Vector3f> series_of(const std::vector<Bell>& profile) {
  constexpr double kLeast = 2e-4;
  constexpr int kLongest = 200;
  std::vector<Vector3f> series;
  for (int k = 0; k < kLongest; ++k) {
    Vector3f coefficient = Vector3f::Zero();
    double largest = 0;
    for (const Bell& bell : profile) {
      const double z = 0.25 * static_cast<double>(bell.variance_mm2 * kSpectrum);
      const double value = (k == 0 ? 1 : 2) * (k % 2 == 0 ? 1 : -1) * std::exp(-z) * std::cyl_bessel_i(k, z);
      coefficient += static_cast<float>(value) * bell.weight;
      largest = std::max(largest, std::abs(value) * static_cast<double>(bell.weight.maxCoeff()));
    }
    series.push_back(coefficient);
    if (k > 2 && largest < kLeast) {
      break;
    }
  }
  // What is cut off must not cost light: at the spectrum's lower end T_k is (-1)^k.
  Vector3f sum = Vector3f::Zero();
  Vector3f wanted = Vector3f::Zero();
  for (std::size_t k = 0; k < series.size(); ++k) {
    sum += (k % 2 == 0 ? 1.0F : -1.0F) * series[k];
  }
  for (const Bell& bell : profile) {
    wanted += bell.weight;
  }
  series[0] += wanted - sum;
  return series;
}

}  // namespace

const std::vector<Bell>& skin_profile() {
  static const std::vector<Bell> profile{
      {0.0064F, {0.233F, 0.455F, 0.649F}}, {0.0484F, {0.100F, 0.336F, 0.344F}},
      {0.187F, {0.118F, 0.198F, 0.0F}},    {0.567F, {0.113F, 0.007F, 0.007F}},
      {1.99F, {0.358F, 0.004F, 0.0F}},     {7.41F, {0.078F, 0.0F, 0.0F}}};
  return profile;
}

Scattering::Scattering(const mesh::Vertices& resting_mm, const mesh::Triangles& triangles) {
  const Eigen::Index count = resting_mm.cols();
  struct Pair {
    std::int32_t from, to;
    float conductance;
  };
  std::vector<Pair> pairs;
  pairs.reserve(static_cast<std::size_t>(6 * triangles.cols()));
  areas_mm2_ = Eigen::VectorXf::Zero(count);
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      const std::int32_t a = triangles(corner, t);
      const std::int32_t b = triangles((corner + 1) % 3, t);
      const std::int32_t c = triangles((corner + 2) % 3, t);
      const Vector3f to_a = resting_mm.col(a) - resting_mm.col(c);
      const Vector3f to_b = resting_mm.col(b) - resting_mm.col(c);
      const float conductance = half_cotangent(to_a, to_b);
      pairs.push_back({a, b, conductance});
      pairs.push_back({b, a, conductance});
      areas_mm2_[c] += to_a.cross(to_b).norm() / 6;
    }
  }
  std::sort(pairs.begin(), pairs.end(), [](const Pair& one, const Pair& other) {
    return one.from != other.from ? one.from < other.from : one.to < other.to;
  });
  first_.assign(static_cast<std::size_t>(count) + 1, 0);
  Eigen::VectorXf sums = Eigen::VectorXf::Zero(count);
  for (std::size_t k = 0; k < pairs.size();) {
    const Pair& pair = pairs[k];
    float conductance = 0;
    for (; k < pairs.size() && pairs[k].from == pair.from && pairs[k].to == pair.to; ++k) {
      conductance += pairs[k].conductance;
    }
    // Obtuse triangles would let light flow uphill, slivers too fast.
    conductance = std::clamp(conductance, 0.0F, 3.0F);
    neighbour_.push_back(pair.to);
    conductance_.push_back(conductance);
    sums[pair.from] += conductance;
    first_[static_cast<std::size_t>(pair.from) + 1] = static_cast<std::int32_t>(neighbour_.size());
  }
  for (std::size_t v = 1; v < first_.size(); ++v) {
    first_[v] = std::max(first_[v], first_[v - 1]);
  }
  areas_mm2_ = areas_mm2_.cwiseMax(2 * sums / kSpectrum).cwiseMax(1e-4F);
}

void Scattering::diffuse(const std::vector<Bell>& profile, const std::vector<std::uint8_t>& active,
                         Eigen::Matrix3Xf& light) const {
  // The active vertices alone, packed.
  std::vector<std::int32_t> packed(active.size(), -1);
  std::vector<std::int32_t> members;
  for (std::size_t v = 0; v < active.size(); ++v) {
    if (active[v] != 0) {
      packed[v] = static_cast<std::int32_t>(members.size());
      members.push_back(static_cast<std::int32_t>(v));
    }
  }
  std::vector<std::int32_t> first{0};
  std::vector<std::int32_t> neighbour;
  std::vector<float> step;
  for (const std::int32_t v : members) {
    const float scale = 2 / (kSpectrum * areas_mm2_[v]);
    for (std::int32_t k = first_[static_cast<std::size_t>(v)]; k < first_[static_cast<std::size_t>(v) + 1];
         ++k) {
      const std::int32_t to = packed[static_cast<std::size_t>(neighbour_[static_cast<std::size_t>(k)])];
      if (to >= 0) {
        neighbour.push_back(to);
        step.push_back(scale * conductance_[static_cast<std::size_t>(k)]);
      }
    }
    first.push_back(static_cast<std::int32_t>(neighbour.size()));
  }
  const auto count = static_cast<Eigen::Index>(members.size());
  // Columns of four: aligned for the processor.
  Eigen::Matrix4Xf before = Eigen::Matrix4Xf::Zero(4, count);
  Eigen::Matrix4Xf now = Eigen::Matrix4Xf::Zero(4, count);
  Eigen::Matrix4Xf after = Eigen::Matrix4Xf::Zero(4, count);
  for (Eigen::Index m = 0; m < count; ++m) {
    before.col(m).head<3>() = light.col(members[static_cast<std::size_t>(m)]);
  }
  const std::vector<Vector3f> series = series_of(profile);
  const auto four = [&](std::size_t k) {
    return Eigen::Vector4f(series[k].x(), series[k].y(), series[k].z(), 0);
  };
  Eigen::Matrix4Xf sum = four(0).asDiagonal() * before;
  constexpr Eigen::Index kBlock = 4096;
  // B = 2 / kSpectrum A - 1 and T_k+1 = 2 B T_k - T_k-1.
  for (std::size_t k = 1; k < series.size(); ++k) {
    const Eigen::Matrix4Xf& from = k == 1 ? before : now;
    const Eigen::Vector4f coefficient = four(k);
    render::for_each_row(static_cast<int>((count + kBlock - 1) / kBlock), [&](int block) {
      const Eigen::Index end = std::min(count, (block + 1) * kBlock);
      for (Eigen::Index m = block * kBlock; m < end; ++m) {
        const auto at = static_cast<std::size_t>(m);
        Eigen::Vector4f flow = Eigen::Vector4f::Zero();
        const Eigen::Vector4f own = from.col(m);
        for (auto n = static_cast<std::size_t>(first[at]); n < static_cast<std::size_t>(first[at + 1]); ++n) {
          flow += step[n] * (own - from.col(neighbour[n]));
        }
        flow -= own;
        const Eigen::Vector4f value = k == 1 ? flow : Eigen::Vector4f(2 * flow - before.col(m));
        after.col(m) = value;
        sum.col(m) += coefficient.cwiseProduct(value);
      }
    });
    if (k > 1) {
      before.swap(now);
    }
    now.swap(after);
  }
  for (Eigen::Index m = 0; m < count; ++m) {
    light.col(members[static_cast<std::size_t>(m)]) = sum.col(m).head<3>();
  }
}

}  // namespace facet::simulation
