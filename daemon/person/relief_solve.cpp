#include "person/relief_solve.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace facet::person {
namespace {

constexpr int kAlbedoRounds = 3;
constexpr float kLeastShading = 1e-4F;
/// Fewer pictures' worth of weight tell nothing of a texel's slope.
constexpr float kFewestPictures = 2;
constexpr int kMostIterations = 200;
constexpr double kTolerance = 1e-3;  ///< of the right side's norm

float tukey(float t) {
  const float rest = 1 - t * t;
  return std::abs(t) < 1 ? rest * rest : 0;
}

/// Of one texel, over its pictures.
struct TexelSums {
  const float* brightness;
  const float* weight;
  std::span<const float> counts;
  const float* slope_u;
  const float* slope_v;
  const Eigen::ArrayXf& shading;
  const AlbedoPrior& albedo;
  Eigen::Index pictures;

  float count_of(Eigen::Index k) const { return counts.empty() ? 1 : counts[static_cast<std::size_t>(k)]; }
  float weight_of(Eigen::Index k) const { return weight[k] * count_of(k); }

  float believed(Eigen::Index k, float rho, float bound) const {
    return weight_of(k) * tukey((brightness[k] - rho * shading[k]) / (albedo.usual_brightness * bound));
  }

  struct Albedo {
    float rho = 0;
    float squares = 0;  ///< of the shading, weighted as rho leaves it
    float seen = 0;
  };

  Albedo solve_albedo(Eigen::Index i, float bound) const {
    Albedo out;
    for (int round = 0; round <= kAlbedoRounds; ++round) {
      float right = albedo.counts * albedo.brightness[i];
      out.squares = albedo.counts;
      out.seen = 0;
      for (Eigen::Index k = 0; k < pictures; ++k) {
        const float w = round == 0 ? weight_of(k) : believed(k, out.rho, bound);
        right += w * shading[k] * brightness[k];
        out.squares += w * shading[k] * shading[k];
        out.seen += w / std::max(count_of(k), 1.0F);  // what counts more is one picture still
      }
      // The last round is for the sums under the last weights alone.
      out.rho = round < kAlbedoRounds ? right / out.squares : out.rho;
    }
    return out;
  }

  void add_to(SlopeSystem& out, Eigen::Index i, float bound) const {
    const auto [rho, squares, seen] = solve_albedo(i, bound);
    if (seen < kFewestPictures) {
      return;
    }
    float uu = 0, uv = 0, vv = 0, eu = 0, ev = 0, u = 0, v = 0;
    for (Eigen::Index k = 0; k < pictures; ++k) {
      const float w = believed(k, rho, bound);
      const float residual = brightness[k] - rho * shading[k];
      uu += w * slope_u[k] * slope_u[k];
      uv += w * slope_u[k] * slope_v[k];
      vv += w * slope_v[k] * slope_v[k];
      eu += w * shading[k] * slope_u[k];
      ev += w * shading[k] * slope_v[k];
      u += w * slope_u[k] * residual;
      v += w * slope_v[k] * residual;
    }
    const float unit = 1 / (albedo.usual_brightness * albedo.usual_brightness);
    out.uu[i] = unit * rho * rho * (uu - eu * eu / squares);
    out.uv[i] = unit * rho * rho * (uv - eu * ev / squares);
    out.vv[i] = unit * rho * rho * (vv - ev * ev / squares);
    out.u[i] = unit * rho * u;
    out.v[i] = unit * rho * v;
  }
};

/// call  with every open texel and its pictures' sums, where the skin has a relief
template <typename Call>
void for_each_open(const TexelGrid& grid, const ShadedPictures& pictures, const AlbedoPrior& albedo,
                   const Eigen::VectorXd& relief_mm, std::span<const float> counts, Call&& call) {
  Eigen::ArrayXf shading(pictures.shading.rows());
  for (const std::int32_t i : grid.open) {
    const auto u = static_cast<float>(relief_mm[i + 1] - relief_mm[i]);
    const auto v = static_cast<float>(relief_mm[grid.down[static_cast<std::size_t>(i)]] - relief_mm[i]);
    shading = (pictures.shading.col(i) + u * pictures.slope_u.col(i) + v * pictures.slope_v.col(i))
                  .array()
                  .max(kLeastShading);
    call(i, TexelSums{pictures.brightness.col(i).data(), pictures.weight.col(i).data(), counts,
                      pictures.slope_u.col(i).data(), pictures.slope_v.col(i).data(), shading, albedo,
                      shading.size()});
  }
}

/// The matrix of pictures and prior.
class ReliefMatrix {
 public:
  ReliefMatrix(const TexelGrid& grid, const SlopeSystem& system, const ReliefPrior& prior)
      : grid_(grid),
        system_(system),
        curvature_(prior.curvature / (prior.texel_mm * prior.texel_mm)),
        slope_(prior.slope / (prior.texel_mm * prior.texel_mm)),
        position_(prior.position) {}

  /// with_pictures 0: the prior alone
  Eigen::VectorXd times(const Eigen::VectorXd& x, double with_pictures = 1) const {
    Eigen::VectorXd out = position_ * x;
    for (const std::int32_t i : grid_.open) {
      const std::int32_t below = grid_.down[static_cast<std::size_t>(i)];
      const double u = x[i + 1] - x[i];
      const double v = x[below] - x[i];
      const double cross = with_pictures * static_cast<double>(system_.uv[i]);
      const double of_u = (with_pictures * static_cast<double>(system_.uu[i]) + slope_) * u + cross * v;
      const double of_v = cross * u + (with_pictures * static_cast<double>(system_.vv[i]) + slope_) * v;
      out[i] -= of_u + of_v;
      out[i + 1] += of_u;
      out[below] += of_v;
    }
    for (const std::int32_t i : grid_.inner) {
      const std::int32_t below = grid_.down[static_cast<std::size_t>(i)];
      const std::int32_t above = grid_.up[static_cast<std::size_t>(i)];
      const double bend = curvature_ * (x[i + 1] + x[i - 1] + x[below] + x[above] - 4 * x[i]);
      out[i] -= 4 * bend;
      out[i + 1] += bend;
      out[i - 1] += bend;
      out[below] += bend;
      out[above] += bend;
    }
    return out;
  }

  Eigen::VectorXd diagonal() const {
    Eigen::VectorXd out = Eigen::VectorXd::Constant(grid_.count(), position_);
    for (const std::int32_t i : grid_.open) {
      const double uu = static_cast<double>(system_.uu[i]) + slope_;
      const double vv = static_cast<double>(system_.vv[i]) + slope_;
      out[i] += uu + vv + 2 * static_cast<double>(system_.uv[i]);
      out[i + 1] += uu;
      out[grid_.down[static_cast<std::size_t>(i)]] += vv;
    }
    for (const std::int32_t i : grid_.inner) {
      out[i] += 16 * curvature_;
      for (const std::int32_t j :
           {i + 1, i - 1, grid_.down[static_cast<std::size_t>(i)], grid_.up[static_cast<std::size_t>(i)]}) {
        out[j] += curvature_;
      }
    }
    return out;
  }

 private:
  const TexelGrid& grid_;
  const SlopeSystem& system_;
  double curvature_, slope_, position_;
};

}  // namespace

SlopeSystem slope_system(const TexelGrid& grid, const ShadedPictures& pictures, const AlbedoPrior& albedo,
                         const Eigen::VectorXd& relief_mm, float bound, std::span<const float> counts) {
  const Eigen::ArrayXf none = Eigen::ArrayXf::Zero(grid.count());
  SlopeSystem out{none, none, none, none, none};
  for_each_open(grid, pictures, albedo, relief_mm, counts,
                [&](Eigen::Index i, const TexelSums& sums) { sums.add_to(out, i, bound); });
  return out;
}

Eigen::ArrayXf albedo_with_relief(const TexelGrid& grid, const ShadedPictures& pictures,
                                  const AlbedoPrior& albedo, const Eigen::VectorXd& relief_mm, float bound) {
  Eigen::ArrayXf out = albedo.brightness;
  for_each_open(grid, pictures, albedo, relief_mm, {},
                [&](Eigen::Index i, const TexelSums& sums) { out[i] = sums.solve_albedo(i, bound).rho; });
  return out;
}

Eigen::VectorXd relief_step(const TexelGrid& grid, const SlopeSystem& system, const ReliefPrior& prior,
                            const Eigen::VectorXd& relief_mm) {
  const ReliefMatrix matrix(grid, system, prior);
  Eigen::VectorXd residual = -matrix.times(relief_mm, 0);
  for (const std::int32_t i : grid.open) {
    const auto u = static_cast<double>(system.u[i]);
    const auto v = static_cast<double>(system.v[i]);
    residual[i] -= u + v;
    residual[i + 1] += u;
    residual[grid.down[static_cast<std::size_t>(i)]] += v;
  }
  const Eigen::VectorXd scale = matrix.diagonal().cwiseInverse();
  const double enough = kTolerance * residual.norm();
  Eigen::VectorXd x = Eigen::VectorXd::Zero(grid.count());
  Eigen::VectorXd direction = scale.cwiseProduct(residual);
  double along = residual.dot(direction);
  for (int iteration = 0; iteration < kMostIterations && residual.norm() > enough; ++iteration) {
    const Eigen::VectorXd image = matrix.times(direction);
    const double length = along / direction.dot(image);
    x += length * direction;
    residual -= length * image;
    const Eigen::VectorXd scaled = scale.cwiseProduct(residual);
    const double next = residual.dot(scaled);
    direction = scaled + (next / along) * direction;
    along = next;
  }
  return x;
}

double agreement_of_halves(const TexelGrid& grid, const ShadedPictures& pictures, const AlbedoPrior& albedo,
                           const ReliefPrior& prior, std::span<const char> halves, float bound) {
  const Eigen::VectorXd flat = Eigen::VectorXd::Zero(grid.count());
  std::array<SlopeSystem, 2> systems;
  std::array<Eigen::VectorXd, 2> reliefs;
  for (std::size_t half = 0; half < 2; ++half) {
    std::vector<float> counts;
    for (const char one : halves) {
      counts.push_back(static_cast<std::size_t>(one) == half ? 1 : 0);
    }
    systems[half] = slope_system(grid, pictures, albedo, flat, bound, counts);
    reliefs[half] = relief_step(grid, systems[half], prior, flat);
  }
  double predicted = 0;
  double expected = 0;
  for (std::size_t half = 0; half < 2; ++half) {
    const Eigen::VectorXd& relief = reliefs[half];
    const SlopeSystem& other = systems[1 - half];
    for (const std::int32_t i : grid.open) {
      const auto u = static_cast<float>(relief[i + 1] - relief[i]);
      const auto v = static_cast<float>(relief[grid.down[static_cast<std::size_t>(i)]] - relief[i]);
      predicted += static_cast<double>(other.u[i] * u + other.v[i] * v);
      expected += static_cast<double>(other.uu[i] * u * u + 2 * other.uv[i] * u * v + other.vv[i] * v * v);
    }
  }
  return expected > 0 ? predicted / expected : 0;
}

}  // namespace facet::person
