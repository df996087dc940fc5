#include "booth/photometric.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "booth/lit_mesh.hpp"
#include "fit/conjugate_gradients.hpp"
#include "maths/statistics.hpp"
#include "render/embree.hpp"

namespace facet::booth {
namespace {

using Eigen::Matrix2f;
using Eigen::Matrix3Xf;
using Eigen::Vector2f;
using Eigen::Vector3f;
using Eigen::VectorXf;

constexpr float kSkin = 0.99F;        ///< of a vertex's stencil
constexpr float kLeastLight = 0.02F;  ///< of a projector's white
constexpr float kDarkNoise = 0.004F;  ///< of a picture's white, linear
constexpr float kResidualReduction = 1e-2F;
constexpr int kAlbedoRounds = 2;
constexpr float kRemembered = 0.8F;  ///< of what is known of an albedo, from slot to slot
constexpr float kForgotten = 0.2F;   ///< of what may be known at best: less is nothing
constexpr int kStrengthRounds = 4;
constexpr Eigen::Index kStrengthVertices = 7200;  ///< that tell them, at least; evenly strewn
constexpr double kStrengthSigma = 0.3;            ///< of a light's strength about the rig file's, relative
constexpr double kAmbientSigma = 0.1;             ///< of ambient light, of a projector's white
constexpr double kLeastStrength = 0.2;            ///< of itself, that a strength is left in one round
constexpr double kLeastShare = 0.3;               ///< of its usual strength, that a lit slot has
constexpr double kFewest = 500;      ///< vertices whose ratio tells whether a slot's lights shone
constexpr std::size_t kAmbient = 4;  ///< its mean and its slope along three axes

float tukey(float t) {
  const float rest = 1 - t * t;
  return std::abs(t) < 1 ? rest * rest : 0;
}

}  // namespace

struct PhotometricStereo::Impl {
  std::shared_ptr<const capture::Rig> rig;
  PhotometricOptions options;
  std::vector<Lamp> lamps;
  /// Ambient light [kAmbient], then of each kind of slot so far its lamps'.
  std::vector<double> strengths = std::vector<double>(kAmbient, 0.0);
  std::map<std::string, std::size_t> first_strengths;  ///< index by LitMesh::light
  std::map<std::string, double> believed;              ///< their sum by LitMesh::light, when last believed

  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  std::vector<std::uint8_t> is_skin;
  VectorXf areas;                          ///< [finest] mm^2
  std::vector<float> edge_weights;         ///< [ring entries] of the Laplacian, 1/mm^2
  Eigen::MatrixXf albedo, albedo_weights;  ///< [cameras][finest] what earlier slots say: mean, information

  std::vector<LitMesh> slots;
  std::vector<Vector2f> slope_of;  ///< [ring entries] G
  VectorXf uprightness;            ///< [finest] of the coarse normal on the surface
  std::vector<Matrix2f> matrices;  ///< [finest] H
  std::vector<Vector2f> vectors;   ///< [finest] b
  VectorXf diagonal, bends, gradient, step;
  fit::GradientsMemory<VectorXf> memory;

  const mesh::Level& fine() const { return hierarchy->finest(); }
  void find_slopes(const Matrix3Xf& coarse_normals);
  Vector3f light_of(const LitMesh& slot, Eigen::Index v) const;
  float shading_of(const LitMesh& slot, Eigen::Index v) const;
  double brighter(const LitMesh& slot) const;
  void fit_strengths();
  double agreement(const LitMesh& slot) const;
  double strength_sum(const LitMesh& slot) const;
  std::string disbelief(const LitMesh& slot) const;
  std::string believe_slots(std::string wrong);
  struct VertexSums {
    float rho = 0;         ///< 0: nothing is known
    float squares = 0;     ///< of the shading, weighed, and what earlier slots know
    float weighed_at = 0;  ///< the albedo of weight_of
  };
  float weight_of(const LitMesh& slot, Eigen::Index row, Eigen::Index v, float rho, float shading) const;
  enum class Earlier { Counts, LeftOut };
  VertexSums albedo_of(std::size_t camera, Eigen::Index v, Earlier earlier = Earlier::Counts) const;
  void gather(Eigen::Index v);
  void solve(const std::vector<float>& added_mm);
  void laplacian(const VectorXf& in, VectorXf& out) const;
  void apply(const VectorXf& in, VectorXf& out);
  void learn();
};

/// The slopes of a height over a vertex's one-ring in the first slot: a plane through its neighbours by least
/// squares.
void PhotometricStereo::Impl::find_slopes(const Matrix3Xf& coarse_normals) {
  const LitMesh& slot = slots.front();
  const mesh::OneRings& rings = fine().one_rings;
  slope_of.assign(rings.neighbours.size(), Vector2f::Zero());
  uprightness = coarse_normals.cwiseProduct(slot.normals).colwise().sum().cwiseMax(0.3F).transpose();
  for_each_vertex(slot.normals.cols(), [&](Eigen::Index v) {
    const auto begin = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)]);
    const auto end = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v) + 1]);
    Matrix2f squares = Matrix2f::Zero();
    for (std::size_t e = begin; e < end; ++e) {
      const Vector3f edge = slot.vertices_mm.col(rings.neighbours[e]) - slot.vertices_mm.col(v);
      slope_of[e] = {edge.dot(slot.first_axes.col(v)), edge.dot(slot.second_axes.col(v))};
      squares += slope_of[e] * slope_of[e].transpose();
    }
    const float determinant = squares.determinant();
    const bool flat = determinant > 1e-3F * squares.trace() * squares.trace();
    const Matrix2f inverse = flat ? Matrix2f(squares.inverse()) : Matrix2f(Matrix2f::Zero());
    for (std::size_t e = begin; e < end; ++e) {
      slope_of[e] = inverse * slope_of[e];
    }
  });
}

Vector3f PhotometricStereo::Impl::light_of(const LitMesh& slot, Eigen::Index v) const {
  Vector3f sum(static_cast<float>(strengths[1]), static_cast<float>(strengths[2]),
               static_cast<float>(strengths[3]));
  for (std::size_t k = 0; k < slot.lamps.size(); ++k) {
    sum += static_cast<float>(strengths[slot.lamps[k].strength]) * slot.towards[k].col(v);
  }
  return sum;
}

float PhotometricStereo::Impl::shading_of(const LitMesh& slot, Eigen::Index v) const {
  return slot.normals.col(v).dot(light_of(slot, v)) + static_cast<float>(strengths[0]);
}

/// How much a slot's picture counts about a vertex, where the albedo is about rho: the inverse of its
/// variance, 0 where it is another thing than skin under the slot's lamps.
float PhotometricStereo::Impl::weight_of(const LitMesh& slot, Eigen::Index row, Eigen::Index v, float rho,
                                         float shading) const {
  if (!(slot.weight(row, v) > 0) || (!slot.lamps.empty() && !(shading > kLeastLight))) {
    return 0;
  }
  const float expected = rho * std::max(shading, 0.0F);
  const float noise = options.sigma_light * expected + kDarkNoise;
  return slot.weight(row, v) / (noise * noise) *
         tukey((slot.brightness(row, v) - expected) / (options.robust * expected + kDarkNoise));
}

/// A vertex's albedo as one camera sees it, and the information about it. earlier: what earlier slots know.
PhotometricStereo::Impl::VertexSums PhotometricStereo::Impl::albedo_of(std::size_t camera, Eigen::Index v,
                                                                       Earlier earlier) const {
  const auto row = static_cast<Eigen::Index>(camera);
  const float known = earlier == Earlier::Counts ? albedo_weights(row, v) : 0;
  VertexSums out;
  if (known > 0) {
    out.rho = albedo(row, v);
  } else {
    float seen = 0;
    float weights = 0;
    for (const LitMesh& slot : slots) {
      const float shading = shading_of(slot, v);
      if (slot.weight(row, v) > 0 && shading > kLeastLight) {
        seen += slot.weight(row, v) * slot.brightness(row, v) / shading;
        weights += slot.weight(row, v);
      }
    }
    out.rho = weights > 0 ? seen / weights : 0;
  }
  for (int round = 0; round < kAlbedoRounds && out.rho > 0; ++round) {
    out.weighed_at = out.rho;
    out.rho = known * albedo(row, v);
    out.squares = known;
    for (const LitMesh& slot : slots) {
      const float shading = shading_of(slot, v);
      const float weight = weight_of(slot, row, v, out.weighed_at, shading);
      out.rho += weight * shading * slot.brightness(row, v);
      out.squares += weight * shading * shading;
    }
    out.rho = out.squares > 0 ? out.rho / out.squares : 0;
  }
  return out;
}

/// How much brighter than by its strengths a slot is beside the blank one: the median over what is seen.
double PhotometricStereo::Impl::brighter(const LitMesh& slot) const {
  std::vector<float> ratios;
  const LitMesh& blank = slots.front();
  for (Eigen::Index v = 0; v < slot.normals.cols(); ++v) {
    const float shading = shading_of(slot, v);
    const float even = shading_of(blank, v);
    for (Eigen::Index camera = 0; camera < slot.weight.rows(); ++camera) {
      if (slot.weight(camera, v) > 0 && blank.weight(camera, v) > 0 && shading > kLeastLight &&
          even > kLeastLight && blank.brightness(camera, v) > kDarkNoise) {
        ratios.push_back(slot.brightness(camera, v) / blank.brightness(camera, v) * even / shading);
      }
    }
  }
  return static_cast<double>(ratios.size()) < kFewest
             ? 1
             : static_cast<double>(maths::nth_of(ratios, ratios.size() / 2));
}

/// Strengths of the lamps that shine and ambient light, from how the slots' pictures differ at each vertex
/// where the mesh lies as depth gave it: Gauss-Newton with the albedos eliminated. Their scale is the
/// albedo's: the blank slot's mean stays.
void PhotometricStereo::Impl::fit_strengths() {
  for (const LitMesh& slot : slots) {
    const auto [at, fresh] = first_strengths.try_emplace(slot.light, strengths.size());
    if (fresh) {
      strengths.resize(strengths.size() + slot.lamps.size(), 1);
    }
  }
  const auto n = static_cast<Eigen::Index>(strengths.size());
  Eigen::VectorXd expected = Eigen::VectorXd::Zero(n);
  std::vector<std::uint8_t> shines(strengths.size(), 0);
  std::fill_n(shines.begin(), kAmbient, std::uint8_t{1});
  for (LitMesh& slot : slots) {
    for (std::size_t k = 0; k < slot.lamps.size(); ++k) {
      slot.lamps[k].strength = first_strengths[slot.light] + k;
      shines[slot.lamps[k].strength] = 1;
    }
    const double scale = slot.lamps.empty() ? 1 : std::clamp(brighter(slot), 0.01, 100.0);
    for (const Shining& shining : slot.lamps) {
      strengths[shining.strength] *= scale;
      expected[static_cast<Eigen::Index>(shining.strength)] = strengths[shining.strength];
    }
  }
  const auto total = [this] {
    double sum = 0;
    for (const Shining& shining : slots.front().lamps) {
      sum += strengths[shining.strength];
    }
    return sum;
  };
  Eigen::VectorXd along(n), basis(n);
  const Eigen::Index stride = std::max<Eigen::Index>(1, slots.front().normals.cols() / kStrengthVertices);
  for (int round = 0; round < kStrengthRounds; ++round) {
    Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(n);
    double seen_count = 0;
    for (Eigen::Index v = 0; v < slots.front().normals.cols(); v += stride) {
      for (std::size_t camera = 0; camera < rig->cameras.size(); ++camera) {
        const auto row = static_cast<Eigen::Index>(camera);
        const VertexSums sums = albedo_of(camera, v, Earlier::LeftOut);
        const auto see = [&](const LitMesh& slot) { return slot.weight(row, v) > 0; };
        if (!(sums.squares > 0) || std::count_if(slots.begin(), slots.end(), see) < 2) {
          continue;
        }
        const auto rho = static_cast<double>(sums.rho);
        const auto square = static_cast<double>(sums.squares);
        along.setZero();
        for (const LitMesh& slot : slots) {
          const float seen = slot.brightness(row, v);
          const float shading = shading_of(slot, v);
          const float residual = seen - sums.rho * shading;
          const auto w = static_cast<double>(weight_of(slot, row, v, sums.weighed_at, shading));
          const Vector3f normal = slot.normals.col(v);
          basis.setZero();
          basis.head<kAmbient>() << 1, normal.cast<double>();
          for (std::size_t k = 0; k < slot.lamps.size(); ++k) {
            basis[static_cast<Eigen::Index>(slot.lamps[k].strength)] =
                static_cast<double>(normal.dot(slot.towards[k].col(v)));
          }
          matrix += w * rho * rho * basis * basis.transpose();
          along += w * static_cast<double>(shading) * basis;
          right += w * rho * static_cast<double>(residual) * basis;
        }
        matrix -= rho * rho * along * along.transpose() / std::max(square, 1e-12);
        seen_count += 1;
      }
    }
    if (seen_count < kFewest) {
      return;
    }
    // What was expected counts as much as a hundredth of what is seen.
    for (Eigen::Index k = 0; k < n; ++k) {
      const double sigma = k < static_cast<Eigen::Index>(kAmbient) ? kAmbientSigma : kStrengthSigma;
      const double prior = 0.01 * seen_count / (sigma * sigma);
      matrix(k, k) += shines[static_cast<std::size_t>(k)] != 0 ? prior : 1e30;
      right[k] += prior * (expected[k] - strengths[static_cast<std::size_t>(k)]);
    }
    const Eigen::VectorXd change = matrix.ldlt().solve(right);
    const double before = total();
    for (std::size_t k = 0; k < strengths.size(); ++k) {
      const double to = strengths[k] + change[static_cast<Eigen::Index>(k)];
      strengths[k] = k < kAmbient ? to : std::max(to, kLeastStrength * strengths[k]);
    }
    const double after = total();
    for (std::size_t k = 0; k < strengths.size(); ++k) {
      strengths[k] *= shines[k] != 0 ? before / after : 1;
    }
  }
}

/// Whether a slot's lights shone in it: correlation over the vertices of how its pictures differ from the
/// blank slot's with how they would. 1 where too little is seen to tell.
double PhotometricStereo::Impl::agreement(const LitMesh& slot) const {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  const LitMesh& blank = slots.front();
  for (Eigen::Index v = 0; v < slot.normals.cols(); ++v) {
    const float shading = shading_of(slot, v);
    const float even = shading_of(blank, v);
    for (Eigen::Index camera = 0; camera < slot.weight.rows(); ++camera) {
      const float seen = slot.brightness(camera, v);
      const float blank_seen = blank.brightness(camera, v);
      if (slot.weight(camera, v) > 0 && blank.weight(camera, v) > 0 && even > kLeastLight &&
          blank_seen > kDarkNoise) {
        const auto expected = static_cast<double>(std::max(0.0F, shading) / even);
        const auto found = static_cast<double>(seen / blank_seen);
        n += 1;
        x += expected;
        y += found;
        xx += expected * expected;
        xy += expected * found;
        yy += found * found;
      }
    }
  }
  if (n < kFewest) {
    return 1;
  }
  const double spread = (n * xx - x * x) * (n * yy - y * y);
  return spread > 0 ? (n * xy - x * y) / std::sqrt(spread) : 0;
}

/// Fits strengths and ambient light to the slots, and leaves out those that their lights did not light: what
/// was fitted to them is forgotten. Returns why, or `wrong`.
std::string PhotometricStereo::Impl::believe_slots(std::string wrong) {
  while (slots.size() > 1) {
    std::vector<double> before = strengths;
    fit_strengths();
    const auto odd = std::find_if(slots.begin() + 1, slots.end(),
                                  [this](const LitMesh& slot) { return !disbelief(slot).empty(); });
    if (odd == slots.end()) {
      for (const LitMesh& slot : slots) {
        believed[slot.light] = strength_sum(slot);
      }
      return wrong;
    }
    wrong = disbelief(*odd);
    slots.erase(odd);
    before.resize(strengths.size(), 1);
    strengths = std::move(before);
  }
  return wrong;
}

double PhotometricStereo::Impl::strength_sum(const LitMesh& slot) const {
  double sum = 0;
  for (const Shining& shining : slot.lamps) {
    sum += strengths[shining.strength];
  }
  return sum;
}

/// Why a slot was not lit as it says; empty where it was.
std::string PhotometricStereo::Impl::disbelief(const LitMesh& slot) const {
  if (slot.lamps.empty()) {
    return {};
  }
  const auto usual = believed.find(slot.light);
  const double share = usual != believed.end() ? strength_sum(slot) / usual->second : 1;
  if (!(share > kLeastShare && share < 1 / kLeastShare)) {
    return fmt::format("slot {} is lit by '{}' at {:.0f} % of its usual strength: is a lamp out?",
                       slot.set->slot, slot.set->light, 100 * share);
  }
  const double found = agreement(slot);
  if (found < static_cast<double>(options.least_agreement)) {
    return fmt::format(
        "slot {} is not lit as '{}' says (correlation {:.2f}): is trigger.light a slot off, or a lamp out?",
        slot.set->slot, slot.set->light, found);
  }
  return {};
}

/// H and b of one vertex.
void PhotometricStereo::Impl::gather(Eigen::Index v) {
  Matrix2f& matrix = matrices[static_cast<std::size_t>(v)];
  Vector2f& vector = vectors[static_cast<std::size_t>(v)];
  matrix.setZero();
  vector.setZero();
  if (is_skin[static_cast<std::size_t>(v)] == 0) {
    return;
  }
  for (std::size_t camera = 0; camera < rig->cameras.size(); ++camera) {
    const auto row = static_cast<Eigen::Index>(camera);
    const VertexSums sums = albedo_of(camera, v);
    if (!(sums.squares > 0)) {
      continue;
    }
    Matrix2f own = Matrix2f::Zero();
    Vector2f along = Vector2f::Zero();
    for (const LitMesh& slot : slots) {
      const float shading = shading_of(slot, v);
      const float w = weight_of(slot, row, v, sums.weighed_at, shading);
      const Vector3f light = light_of(slot, v);
      const Vector2f slope =
          -sums.rho * Vector2f(light.dot(slot.first_axes.col(v)), light.dot(slot.second_axes.col(v)));
      own += w * slope * slope.transpose();
      along += w * shading * slope;
      vector += w * (slot.brightness(row, v) - sums.rho * shading) * slope;
    }
    matrix += own - along * along.transpose() / sums.squares;
  }
}

void PhotometricStereo::Impl::laplacian(const VectorXf& in, VectorXf& out) const {
  const mesh::OneRings& rings = fine().one_rings;
  out.resize(in.size());
  for_each_vertex(in.size(), [&](Eigen::Index v) {
    float sum = 0;
    for (auto e = rings.offsets[static_cast<std::size_t>(v)];
         e < rings.offsets[static_cast<std::size_t>(v) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum += edge_weights[edge] * (in[rings.neighbours[edge]] - in[v]);
    }
    out[v] = sum;
  });
}

/// out = (G^T A H G + A / sigma_depth^2 + L^T A L / sigma_bend^2) in.
void PhotometricStereo::Impl::apply(const VectorXf& in, VectorXf& out) {
  const mesh::OneRings& rings = fine().one_rings;
  const float depth = 1 / (options.sigma_depth_mm * options.sigma_depth_mm);
  const float bend = 1 / (options.sigma_bend * options.sigma_bend);
  laplacian(in, bends);
  out = depth * areas.cwiseProduct(in);
  const VectorXf height = uprightness.cwiseProduct(in);
  for (Eigen::Index v = 0; v < in.size(); ++v) {
    const auto begin = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)]);
    const auto end = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v) + 1]);
    Vector2f slope = Vector2f::Zero();
    for (std::size_t e = begin; e < end; ++e) {
      slope += slope_of[e] * (height[rings.neighbours[e]] - height[v]);
    }
    const Vector2f pull = areas[v] * (matrices[static_cast<std::size_t>(v)] * slope);
    const float bent = bend * areas[v] * bends[v];
    float here = 0;
    for (std::size_t e = begin; e < end; ++e) {
      const std::int32_t beside = rings.neighbours[e];
      const float of_slope = slope_of[e].dot(pull);
      const float of_bend = edge_weights[e] * bent;
      out[beside] += uprightness[beside] * of_slope + of_bend;
      here += uprightness[v] * of_slope + of_bend;
    }
    out[v] -= here;
  }
}

/// step: the change of what is added.
void PhotometricStereo::Impl::solve(const std::vector<float>& added_mm) {
  const mesh::OneRings& rings = fine().one_rings;
  const Eigen::Index count = areas.size();
  const float depth = 1 / (options.sigma_depth_mm * options.sigma_depth_mm);
  const float bend = 1 / (options.sigma_bend * options.sigma_bend);
  const Eigen::Map<const VectorXf> added(added_mm.data(), count);
  // The gradient of depth and smoothness at what is added already ...
  std::vector<Matrix2f> kept(static_cast<std::size_t>(count), Matrix2f::Zero());
  kept.swap(matrices);
  apply(added, gradient);
  kept.swap(matrices);
  diagonal = depth * areas;
  // ... and that of the light, and the diagonal of all.
  for (Eigen::Index v = 0; v < count; ++v) {
    const auto begin = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)]);
    const auto end = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v) + 1]);
    const Matrix2f& matrix = matrices[static_cast<std::size_t>(v)];
    const Vector2f& vector = vectors[static_cast<std::size_t>(v)];
    Vector2f all = Vector2f::Zero();
    float edges = 0;
    for (std::size_t e = begin; e < end; ++e) {
      const std::int32_t beside = rings.neighbours[e];
      const float upright = uprightness[beside];
      gradient[beside] -= areas[v] * upright * slope_of[e].dot(vector);
      diagonal[beside] += areas[v] * (upright * upright * slope_of[e].dot(matrix * slope_of[e]) +
                                      bend * edge_weights[e] * edge_weights[e]);
      all += slope_of[e];
      edges += edge_weights[e];
    }
    gradient[v] += areas[v] * uprightness[v] * all.dot(vector);
    diagonal[v] +=
        areas[v] * (uprightness[v] * uprightness[v] * all.dot(matrix * all) + bend * edges * edges);
  }
  diagonal = diagonal.cwiseMax(1e-12F);
  step.resize(count);
  fit::conjugate_gradients(
      gradient, options.cg_iterations, kResidualReduction,
      [this](const VectorXf& in, VectorXf& out) { apply(in, out); },
      [this](const VectorXf& in, VectorXf& out) { out = in.cwiseQuotient(diagonal); }, memory, step);
}

/// What this slot's pictures say of the albedos, for those to come.
void PhotometricStereo::Impl::learn() {
  for_each_vertex(areas.size(), [&](Eigen::Index v) {
    for (std::size_t camera = 0; camera < rig->cameras.size(); ++camera) {
      const VertexSums sums = albedo_of(camera, v);
      if (sums.squares > 0 && sums.rho > 0) {
        const auto row = static_cast<Eigen::Index>(camera);
        const float most = 1 / (options.sigma_albedo * options.sigma_albedo * sums.rho * sums.rho);
        // What is not seen again is forgotten.
        const float kept = kRemembered * std::min(sums.squares, most);
        albedo(row, v) = sums.rho;
        albedo_weights(row, v) = kept > kForgotten * most ? kept : 0;
      }
    }
  });
}

PhotometricStereo::PhotometricStereo(std::shared_ptr<const capture::Rig> rig,
                                     const PhotometricOptions& options)
    : impl_(std::make_unique<Impl>()) {
  render::require_embree();
  impl_->rig = std::move(rig);
  impl_->options = options;
  impl_->lamps = lamps_of(*impl_->rig);
}

PhotometricStereo::~PhotometricStereo() = default;

void PhotometricStereo::begin(std::shared_ptr<const mesh::Hierarchy> hierarchy,
                              const fit::TemplateMesh& surface) {
  Impl& impl = *impl_;
  impl.hierarchy = std::move(hierarchy);
  const mesh::Level& fine = impl.fine();
  mesh::Vertices neutral_mm;
  mesh::apply(fine.from_coarser, surface.neutral_mm, neutral_mm);
  Eigen::MatrixXf skin(1, surface.vertex_count()), fine_skin;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    skin(0, v) = surface.is_skin[static_cast<std::size_t>(v)] != 0 ? 1.0F : 0.0F;
  }
  mesh::apply(fine.from_coarser, skin, fine_skin);
  const mesh::OneRings& rings = fine.one_rings;
  impl.is_skin.assign(static_cast<std::size_t>(fine.vertex_count), 0);
  impl.areas = VectorXf::Zero(fine.vertex_count);
  impl.edge_weights.assign(rings.neighbours.size(), 0);
  for (Eigen::Index t = 0; t < fine.triangles.cols(); ++t) {
    const auto corner = fine.triangles.col(t);
    const Vector3f a = neutral_mm.col(corner[0]);
    const float third = (neutral_mm.col(corner[1]) - a).cross(neutral_mm.col(corner[2]) - a).norm() / 6;
    for (Eigen::Index i = 0; i < 3; ++i) {
      impl.areas[corner[i]] += third;
    }
  }
  for (std::int32_t v = 0; v < fine.vertex_count; ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    const auto begin = static_cast<std::size_t>(rings.offsets[vertex]);
    const auto end = static_cast<std::size_t>(rings.offsets[vertex + 1]);
    if (rings.on_boundary[vertex] != 0) {
      continue;
    }
    impl.is_skin[vertex] = fine_skin(0, v) > kSkin ? 1 : 0;
    for (std::size_t e = begin; e < end; ++e) {
      const float length = std::max(0.2F, (neutral_mm.col(rings.neighbours[e]) - neutral_mm.col(v)).norm());
      impl.edge_weights[e] = 4 / (static_cast<float>(end - begin) * length * length);
    }
  }
  const auto cameras = static_cast<Eigen::Index>(impl.rig->cameras.size());
  impl.albedo = Eigen::MatrixXf::Zero(cameras, fine.vertex_count);
  impl.albedo_weights = Eigen::MatrixXf::Zero(cameras, fine.vertex_count);
  impl.matrices.assign(impl.is_skin.size(), Matrix2f::Zero());
  impl.vectors.assign(impl.is_skin.size(), Vector2f::Zero());
}

std::string PhotometricStereo::refine(const FrameSet& blank, std::span<const LitSlot> lit,
                                      const mesh::Vertices& before_mm, const mesh::Vertices& now_mm,
                                      std::span<const float> displacements_mm, std::vector<float>& added_mm) {
  Impl& impl = *impl_;
  added_mm.assign(displacements_mm.size(), 0);
  impl.slots.clear();
  LitMesh& first = impl.slots.emplace_back();
  first.set = &blank;
  first.light = "blank";
  first.template_mm = now_mm;
  for (std::size_t k = 0; k < impl.rig->projectors.size(); ++k) {
    first.lamps.push_back({k, 0});
  }
  std::string wrong;
  for (const LitSlot& one : lit) {
    LitMesh& slot = impl.slots.emplace_back();
    slot.set = one.set;
    slot.template_mm = before_mm + static_cast<float>(one.fraction) * (now_mm - before_mm);
    for (const std::string& name : one.lights) {
      const auto at = std::find_if(impl.lamps.begin(), impl.lamps.end(),
                                   [&](const Lamp& lamp) { return lamp.name == name; });
      if (at == impl.lamps.end()) {
        wrong = fmt::format("the rig file has no light or projector '{}', which slot {} names", name,
                            one.set->slot);
        impl.slots.pop_back();
        break;
      }
      slot.lamps.push_back({static_cast<std::size_t>(at - impl.lamps.begin()), 0});
      slot.light += "+" + name;
    }
  }
  if (impl.slots.size() < 2) {
    impl.slots.clear();
    return wrong;
  }
  const std::vector<float> by_depth(displacements_mm.begin(), displacements_mm.end());
  for (LitMesh& slot : impl.slots) {
    slot.stand_on(*impl.hierarchy, by_depth);
    slot.cast_shadows(impl.fine(), impl.lamps, impl.is_skin);
    slot.look(impl.fine(), *impl.rig, impl.is_skin);
  }
  wrong = impl.believe_slots(wrong);
  if (impl.slots.size() < 2) {
    impl.slots.clear();
    return wrong;
  }
  mesh::Vertices coarse_mm;
  Matrix3Xf coarse_normals;
  mesh::apply(impl.fine().from_coarser, now_mm, coarse_mm);
  mesh::vertex_normals(coarse_mm, impl.fine().triangles, coarse_normals);
  std::vector<float> together = by_depth;
  for (int k = 0; k < impl.options.steps; ++k) {
    if (k > 0) {
      for (LitMesh& slot : impl.slots) {
        slot.stand_on(*impl.hierarchy, together);
      }
    }
    impl.find_slopes(coarse_normals);
    for_each_vertex(impl.areas.size(), [&](Eigen::Index v) { impl.gather(v); });
    impl.solve(added_mm);
    for (std::size_t v = 0; v < added_mm.size(); ++v) {
      added_mm[v] += impl.step[static_cast<Eigen::Index>(v)];
      together[v] = by_depth[v] + added_mm[v];
    }
  }
  for (LitMesh& slot : impl.slots) {
    slot.stand_on(*impl.hierarchy, together);
  }
  impl.learn();
  impl.slots.clear();  // they name pictures that are not ours
  return wrong;
}

double PhotometricStereo::strength_of(const std::string& light) const {
  const auto at = impl_->first_strengths.find("+" + light);
  return at == impl_->first_strengths.end() ? 0 : impl_->strengths[at->second];
}

double PhotometricStereo::ambient() const {
  return impl_->strengths[0] + impl_->strengths[3];
}

}  // namespace facet::booth
