#include "report/bands.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

namespace facet::report {
namespace {

using Eigen::Vector3f;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kNarrow_mm = 0.6F;
constexpr float kWide_mm = 4;
constexpr float kWidest_mm = 15;
constexpr float kFold_mm = 0.08F;

/// Vertices where the truth is known, with the smoother that knows them and their spacing.
struct Ground {
  std::vector<std::int32_t> vertices;
  double spacing_mm = 0;  ///< mean length of their edges

  /// One round moves half the weight by one spacing: a variance of spacing^2 / 4 along either axis.
  int rounds(float width_mm) const {
    const double ratio = static_cast<double>(width_mm) / spacing_mm;
    return static_cast<int>(std::lround(4 * ratio * ratio));
  }
};

Ground ground_of(const mesh::OneRings& rings, const Reconstruction& mesh, const std::vector<float>& true_mm) {
  Ground ground;
  std::int64_t edges = 0;
  for (const std::int32_t vertex : mesh.measured) {
    const auto v = static_cast<std::size_t>(vertex);
    if (std::isnan(true_mm[v])) {
      continue;
    }
    ground.vertices.push_back(vertex);
    for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
      const std::int32_t j = rings.neighbours[static_cast<std::size_t>(k)];
      ground.spacing_mm +=
          static_cast<double>((mesh.vertices_mm.col(vertex) - mesh.vertices_mm.col(j)).norm());
      ++edges;
    }
  }
  ground.spacing_mm /= static_cast<double>(std::max<std::int64_t>(edges, 1));
  return ground;
}

/// Truth and recovered at some vertices. [2][vertices]
Eigen::Matrix2Xf gather(const std::vector<std::int32_t>& vertices, const std::vector<float>& true_mm,
                        std::span<const float> recovered_mm) {
  Eigen::Matrix2Xf fields(2, static_cast<Eigen::Index>(vertices.size()));
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const auto v = static_cast<std::size_t>(vertices[k]);
    fields.col(static_cast<Eigen::Index>(k)) << true_mm[v], recovered_mm[v];
  }
  return fields;
}

BandField all_of(const std::vector<std::int32_t>& vertices, const Eigen::Matrix2Xf& fields) {
  BandField out;
  out.vertices = vertices;
  for (Eigen::Index k = 0; k < fields.cols(); ++k) {
    out.true_mm.push_back(fields(0, k));
    out.recovered_mm.push_back(fields(1, k));
  }
  return out;
}

/// Vertices that share a cube of kCell_mm, so that every piece of skin counts by its size and not by how many
/// vertices it has.
struct Cells {
  std::vector<std::int32_t> vertices;  ///< one of each cell
  Eigen::Matrix3Xf middles_mm;         ///< [3][cells] of its vertices
  Eigen::Matrix2Xf fields;             ///< [2][cells] mean over its vertices
};

constexpr float kCell_mm = 3;

Cells cells_of(const Reconstruction& mesh, const Ground& ground, const Eigen::Matrix2Xf& fields) {
  // By cell; within one by place, so that sums do not depend on how the map orders them.
  std::map<std::array<int, 3>, std::vector<std::size_t>> places;
  for (std::size_t k = 0; k < ground.vertices.size(); ++k) {
    const Eigen::Array3f cell = (mesh.vertices_mm.col(ground.vertices[k]).array() / kCell_mm).floor();
    places[{static_cast<int>(cell[0]), static_cast<int>(cell[1]), static_cast<int>(cell[2])}].push_back(k);
  }
  Cells cells;
  const auto count = static_cast<Eigen::Index>(places.size());
  cells.middles_mm.setZero(3, count);
  cells.fields.setZero(2, count);
  for (const auto& [cell, members] : places) {
    const auto c = static_cast<Eigen::Index>(cells.vertices.size());
    for (const std::size_t k : members) {
      cells.middles_mm.col(c) += mesh.vertices_mm.col(ground.vertices[k]);
      cells.fields.col(c) += fields.col(static_cast<Eigen::Index>(k));
    }
    cells.middles_mm.col(c) /= static_cast<float>(members.size());
    cells.fields.col(c) /= static_cast<float>(members.size());
    cells.vertices.push_back(ground.vertices[members.front()]);
  }
  return cells;
}

/// wide: the displacements after G_4. [2][ground]
BandField split_middle(const Reconstruction& mesh, const Ground& ground, const Eigen::Matrix2Xf& wide) {
  const Cells cells = cells_of(mesh, ground, wide);
  constexpr float kVariance_mm2 = kWidest_mm * kWidest_mm - kWide_mm * kWide_mm;
  constexpr float kReach_mm2 = 9 * kVariance_mm2;
  const Eigen::Index count = cells.fields.cols();
  Eigen::Matrix2Xf widest = cells.fields;
  Eigen::VectorXf weights = Eigen::VectorXf::Ones(count);
  for (Eigen::Index a = 0; a < count; ++a) {
    for (Eigen::Index b = a + 1; b < count; ++b) {
      const float distance_mm2 = (cells.middles_mm.col(a) - cells.middles_mm.col(b)).squaredNorm();
      if (distance_mm2 < kReach_mm2) {
        const float weight = std::exp(-distance_mm2 / (2 * kVariance_mm2));
        widest.col(a) += weight * cells.fields.col(b);
        widest.col(b) += weight * cells.fields.col(a);
        weights[a] += weight;
        weights[b] += weight;
      }
    }
  }
  widest.array().rowwise() /= weights.transpose().array();
  return all_of(cells.vertices, cells.fields - widest);
}

/// Splits off the wrinkles; wide becomes G_4 of the fields.
BandField split_folds(const Ground& ground, const RingSmoother& smoother, Eigen::Matrix2Xf& wide) {
  smoother.smooth(wide, ground.rounds(kNarrow_mm));
  Eigen::Matrix2Xf narrow = wide;
  smoother.smooth(wide, ground.rounds(kWide_mm) - ground.rounds(kNarrow_mm));
  narrow -= wide;
  Eigen::Matrix2Xf power = narrow.array().square();
  smoother.smooth(power, ground.rounds(kWide_mm));
  BandField folds;
  for (Eigen::Index k = 0; k < narrow.cols(); ++k) {
    if (power(0, k) > kFold_mm * kFold_mm) {
      folds.vertices.push_back(ground.vertices[static_cast<std::size_t>(k)]);
      folds.true_mm.push_back(narrow(0, k));
      folds.recovered_mm.push_back(narrow(1, k));
    }
  }
  return folds;
}

}  // namespace

std::vector<float> true_displacements_mm(const Reconstruction& mesh, const maths::Similarity& truth_from_mesh,
                                         const Truth& truth) {
  constexpr float kDeepest_mm = 6;
  std::vector<float> out(static_cast<std::size_t>(mesh.vertices_mm.cols()), kNaN);
  constexpr std::size_t kBlock = 256;
  const std::size_t count = mesh.measured.size();
  render::for_each_row(static_cast<int>((count + kBlock - 1) / kBlock), [&](int block) {
    const std::size_t end = std::min(count, (static_cast<std::size_t>(block) + 1) * kBlock);
    for (std::size_t k = static_cast<std::size_t>(block) * kBlock; k < end; ++k) {
      const std::int32_t v = mesh.measured[k];
      const Vector3f at = truth_from_mesh * Vector3f(mesh.vertices_mm.col(v));
      const Vector3f normal = truth_from_mesh.rotation * mesh.normals.col(v);
      const auto outwards = truth.caster().first_hit(at, normal);
      const auto inwards = truth.caster().first_hit(at, -normal);
      const bool is_inside =
          outwards.triangle >= 0 && (inwards.triangle < 0 || outwards.distance_mm < inwards.distance_mm);
      if (is_inside || inwards.triangle >= 0) {
        const float reach_mm =
            (is_inside ? outwards.distance_mm : -inwards.distance_mm) / truth_from_mesh.scale;
        if (std::abs(reach_mm) < kDeepest_mm) {
          out[static_cast<std::size_t>(v)] = reach_mm;
        }
      }
    }
  });
  return out;
}

void FieldSum::add(double truth, double recovered) {
  ++count_;
  sums_[0] += truth;
  sums_[1] += recovered;
  sums_[2] += truth * truth;
  sums_[3] += recovered * recovered;
  sums_[4] += truth * recovered;
}

void FieldSum::add(std::span<const float> truth, std::span<const float> recovered) {
  for (std::size_t k = 0; k < truth.size(); ++k) {
    add(static_cast<double>(truth[k]), static_cast<double>(recovered[k]));
  }
}

double FieldSum::correlation() const {
  const auto count = static_cast<double>(count_);
  const double true_variance = sums_[2] - sums_[0] * sums_[0] / count;
  const double recovered_variance = sums_[3] - sums_[1] * sums_[1] / count;
  const double product = true_variance * recovered_variance;
  return product > 0 ? (sums_[4] - sums_[0] * sums_[1] / count) / std::sqrt(product)
                     : std::numeric_limits<double>::quiet_NaN();
}

double FieldSum::depth() const {
  const auto count = static_cast<double>(count_);
  const double true_variance = sums_[2] - sums_[0] * sums_[0] / count;
  return true_variance > 0 ? (sums_[4] - sums_[0] * sums_[1] / count) / true_variance
                           : std::numeric_limits<double>::quiet_NaN();
}

double FieldSum::true_rms() const {
  return std::sqrt(sums_[2] / static_cast<double>(count_));
}

double FieldSum::error_rms() const {
  return std::sqrt(std::max(0.0, sums_[2] + sums_[3] - 2 * sums_[4]) / static_cast<double>(count_));
}

RingSmoother::RingSmoother(const mesh::OneRings& rings, const std::vector<std::int32_t>& vertices) {
  std::vector<std::int32_t> place(rings.offsets.size() - 1, -1);
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    place[static_cast<std::size_t>(vertices[k])] = static_cast<std::int32_t>(k);
  }
  offsets_.push_back(0);
  for (const std::int32_t vertex : vertices) {
    const auto v = static_cast<std::size_t>(vertex);
    for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
      const std::int32_t neighbour =
          place[static_cast<std::size_t>(rings.neighbours[static_cast<std::size_t>(k)])];
      if (neighbour >= 0) {
        neighbours_.push_back(neighbour);
      }
    }
    if (static_cast<std::size_t>(offsets_.back()) == neighbours_.size()) {
      neighbours_.push_back(static_cast<std::int32_t>(offsets_.size()) - 1);
    }
    offsets_.push_back(static_cast<std::int32_t>(neighbours_.size()));
  }
}

void RingSmoother::average(const Eigen::Matrix2Xf& fields, Eigen::Matrix2Xf& out) const {
  for (std::size_t v = 0; v + 1 < offsets_.size(); ++v) {
    Eigen::Vector2f sum = Eigen::Vector2f::Zero();
    for (std::int32_t k = offsets_[v]; k < offsets_[v + 1]; ++k) {
      sum += fields.col(neighbours_[static_cast<std::size_t>(k)]);
    }
    out.col(static_cast<Eigen::Index>(v)) = sum / static_cast<float>(offsets_[v + 1] - offsets_[v]);
  }
}

void RingSmoother::smooth(Eigen::Matrix2Xf& fields, int rounds) const {
  if (rounds <= 0 || fields.cols() == 0) {
    return;
  }
  // C(2n, n) / 4^n, and from each coefficient the next. What is left out at the end goes to the sum, so that
  // a constant stays itself.
  const auto n = static_cast<double>(rounds);
  double share = std::exp(std::lgamma(2 * n + 1) - 2 * std::lgamma(n + 1) - 2 * n * std::numbers::ln2);
  constexpr double kLeftOut = 1e-5;
  std::vector<float> shares{static_cast<float>(share)};
  double sum = share;
  for (double k = 0; k < n && 1 - sum > kLeftOut; ++k) {
    share *= (n - k) / (n + k + 1);
    shares.push_back(static_cast<float>(2 * share));
    sum += 2 * share;
  }
  for (float& one : shares) {
    one /= static_cast<float>(sum);
  }
  Eigen::Matrix2Xf last = fields;  // T_k-1
  Eigen::Matrix2Xf now(2, fields.cols());
  average(last, now);
  Eigen::Matrix2Xf averaged(2, fields.cols());
  fields *= shares[0];
  for (std::size_t k = 1; k < shares.size(); ++k) {
    fields += shares[k] * now;
    if (k + 1 < shares.size()) {
      average(now, averaged);
      last = 2 * averaged - last;
      last.swap(now);
    }
  }
}

BandFields split_bands(const mesh::OneRings& rings, const Reconstruction& mesh,
                       const std::vector<float>& true_mm, std::span<const float> recovered_mm) {
  const Ground ground = ground_of(rings, mesh, true_mm);
  if (ground.vertices.empty()) {
    return {};
  }
  BandFields bands;
  Eigen::Matrix2Xf fields = gather(ground.vertices, true_mm, recovered_mm);
  bands.whole = all_of(ground.vertices, fields);
  bands.wrinkles = split_folds(ground, RingSmoother(rings, ground.vertices), fields);
  bands.middle = split_middle(mesh, ground, fields);
  return bands;
}

BandField split_wrinkles(const mesh::OneRings& rings, const Reconstruction& mesh,
                         const std::vector<float>& true_mm, std::span<const float> recovered_mm) {
  const Ground ground = ground_of(rings, mesh, true_mm);
  if (ground.vertices.empty()) {
    return {};
  }
  Eigen::Matrix2Xf fields = gather(ground.vertices, true_mm, recovered_mm);
  return split_folds(ground, RingSmoother(rings, ground.vertices), fields);
}

void WrinkleSum::add(const mesh::OneRings& rings, const Reconstruction& mesh,
                     const std::vector<float>& true_mm, std::span<const float> recovered_mm) {
  const BandField wrinkles = split_wrinkles(rings, mesh, true_mm, recovered_mm);
  sum_.add(wrinkles.true_mm, wrinkles.recovered_mm);
}

}  // namespace facet::report
