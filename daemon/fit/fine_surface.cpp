#include "fit/fine_surface.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "facet/error.hpp"
#include "fit/conjugate_gradients.hpp"
#include "fit/depth_pull.hpp"

namespace facet::fit {

namespace {

using Eigen::Matrix3Xf;
using Eigen::Vector3f;
using Eigen::VectorXf;

constexpr double kLeastSeen = 0.05;
constexpr float kSettledMm = 0.005F;
constexpr float kSkin = 0.99F;         ///< of a vertex's stencil
constexpr float kHold = 0.05F;         ///< towards 0 where no map sees a vertex, of a map's weight
constexpr float kLeastEdgeMm = 0.2F;   ///< in the Laplacian
constexpr float kLeastUpright = 0.1F;  ///< cosine between a triangle and the coarse normals
constexpr int kUnfoldRounds = 8;
constexpr float kResidualReduction = 1e-2F;  ///< of the conjugate gradients

}  // namespace

struct FineSurface::Impl {
  Impl(const mesh::ControlMesh& control, std::shared_ptr<const TemplateMesh> with, const FineOptions& how)
      : surface(std::move(with)), options(how) {
    if (!(options.sigma_mm > 0) || !(options.smoothness >= 0) || options.steps < 1 ||
        options.cg_iterations < 1) {
      throw Error(ErrorKind::Usage, "the options of the fine surface make no sense");
    }
    hierarchy = mesh::build_hierarchy_below(control, surface->vertex_count(), options.sweeps);
    const mesh::Level& fine = hierarchy->finest();
    mesh::Vertices neutral_mm;
    mesh::apply(fine.from_coarser, surface->neutral_mm, neutral_mm);
    measure(neutral_mm);
    Eigen::MatrixXf skin(1, surface->vertex_count());
    for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
      skin(0, v) = surface->is_skin[static_cast<std::size_t>(v)] != 0 ? 1.0F : 0.0F;
    }
    Eigen::MatrixXf fine_skin;
    mesh::apply(fine.from_coarser, skin, fine_skin);
    for (Eigen::Index i = 0; i < fine_skin.cols(); ++i) {
      is_skin.push_back(fine_skin(0, i) > kSkin ? 1 : 0);
    }
    for (VectorXf* field : {&diagonal, &blocks, &gradient, &step, &scratch}) {
      field->setZero(fine.vertex_count);
    }
  }

  void measure(const mesh::Vertices& neutral_mm);
  void laplacian(const VectorXf& in, VectorXf& out) const;
  void add_transposed_laplacian(const VectorXf& in, VectorXf& out) const;
  void apply(const VectorXf& in, VectorXf& out);
  void solve_step();
  void stand_on(const mesh::Vertices& template_mm);
  int unfold(std::span<const float> kept_mm, std::span<float> moved_mm, std::span<float> confidence);
  int add(const mesh::Vertices& template_mm, std::span<const float> displacements_mm,
          std::span<const float> added_mm, std::vector<float>& sum_mm);
  TemplateFitReport fit(std::span<const capture::DepthMap> maps, const mesh::Vertices& template_mm,
                        std::vector<float>& displacements_mm, std::vector<float>& confidence);

  std::shared_ptr<const TemplateMesh> surface;
  FineOptions options;
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  std::vector<std::uint8_t> is_skin;  ///< [finest vertex_count]
  std::vector<float> edge_weights;    ///< [one-ring entries] of the Laplacian, 1 / mm^2; 0 at the boundary
  VectorXf edge_sums;                 ///< [finest vertex_count]
  VectorXf areas;                     ///< [finest vertex_count] mm^2
  VectorXf smooth_diagonal;           ///< of the smoothness' part of the normal equations
  VectorXf diagonal, blocks, gradient, step, scratch;
  GradientsMemory<VectorXf> memory;
  mesh::Vertices base_mm, now_mm;
  Matrix3Xf normals, fine_normals;
};

/// Areas, and the Laplacian's weights: (4 / n) / edge^2 for each of n neighbours, which is the Laplacian of
/// the plane at the regular vertices of a 4-8 mesh, of valence 4 and of valence 8.
void FineSurface::Impl::measure(const mesh::Vertices& neutral_mm) {
  const mesh::Level& fine = hierarchy->finest();
  const mesh::OneRings& rings = fine.one_rings;
  areas.setZero(fine.vertex_count);
  for (Eigen::Index t = 0; t < fine.triangles.cols(); ++t) {
    const auto corner = fine.triangles.col(t);
    const Vector3f a = neutral_mm.col(corner[0]);
    const float third = (neutral_mm.col(corner[1]) - a).cross(neutral_mm.col(corner[2]) - a).norm() / 6;
    for (Eigen::Index i = 0; i < 3; ++i) {
      areas[corner[i]] += third;
    }
  }
  edge_weights.assign(rings.neighbours.size(), 0);
  edge_sums.setZero(fine.vertex_count);
  smooth_diagonal.setZero(fine.vertex_count);
  const auto smoothness = static_cast<float>(options.smoothness);
  for (std::int32_t i = 0; i < fine.vertex_count; ++i) {
    const auto begin = rings.offsets[static_cast<std::size_t>(i)];
    const auto end = rings.offsets[static_cast<std::size_t>(i) + 1];
    if (rings.on_boundary[static_cast<std::size_t>(i)] != 0) {
      continue;
    }
    for (auto e = begin; e < end; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      const float length =
          std::max((neutral_mm.col(i) - neutral_mm.col(rings.neighbours[edge])).norm(), kLeastEdgeMm);
      edge_weights[edge] = 4 / (static_cast<float>(end - begin) * length * length);
      edge_sums[i] += edge_weights[edge];
      smooth_diagonal[rings.neighbours[edge]] +=
          smoothness * areas[i] * edge_weights[edge] * edge_weights[edge];
    }
    smooth_diagonal[i] += smoothness * areas[i] * edge_sums[i] * edge_sums[i];
  }
}

void FineSurface::Impl::laplacian(const VectorXf& in, VectorXf& out) const {
  const mesh::OneRings& rings = hierarchy->finest().one_rings;
  for (Eigen::Index i = 0; i < in.size(); ++i) {
    float sum = -edge_sums[i] * in[i];
    for (auto e = rings.offsets[static_cast<std::size_t>(i)];
         e < rings.offsets[static_cast<std::size_t>(i) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      sum += edge_weights[edge] * in[rings.neighbours[edge]];
    }
    out[i] = sum;
  }
}

void FineSurface::Impl::add_transposed_laplacian(const VectorXf& in, VectorXf& out) const {
  const mesh::OneRings& rings = hierarchy->finest().one_rings;
  for (Eigen::Index i = 0; i < in.size(); ++i) {
    out[i] -= edge_sums[i] * in[i];
    for (auto e = rings.offsets[static_cast<std::size_t>(i)];
         e < rings.offsets[static_cast<std::size_t>(i) + 1]; ++e) {
      const auto edge = static_cast<std::size_t>(e);
      out[rings.neighbours[edge]] += edge_weights[edge] * in[i];
    }
  }
}

/// out = (data + smoothness L^T A L) in.
void FineSurface::Impl::apply(const VectorXf& in, VectorXf& out) {
  laplacian(in, scratch);
  scratch.array() *= static_cast<float>(options.smoothness) * areas.array();
  out = blocks.cwiseProduct(in);
  add_transposed_laplacian(scratch, out);
}

/// step = -H^-1 gradient, with the diagonal as preconditioner.
void FineSurface::Impl::solve_step() {
  diagonal = (blocks + smooth_diagonal).cwiseMax(1e-12F);
  conjugate_gradients(
      gradient, options.cg_iterations, kResidualReduction,
      [this](const VectorXf& in, VectorXf& out) { apply(in, out); },
      [this](const VectorXf& in, VectorXf& out) { out = in.cwiseQuotient(diagonal); }, memory, step);
}

/// Displacements along normals that meet can turn a triangle over, in a fold of the skin or where two
/// surfaces touch: there they are no heights, and are taken back by halves until it lies the right way round.
/// kept_mm     [finest vertex_count] what stays of them; empty: nothing
/// moved_mm    [finest vertex_count] what is taken back
/// confidence  halved with it; empty: none
/// Returns how many triangles were turned over.
int FineSurface::Impl::unfold(std::span<const float> kept_mm, std::span<float> moved_mm,
                              std::span<float> confidence) {
  const mesh::Triangles& triangles = hierarchy->finest().triangles;
  int turned = 0;
  bool again = true;
  for (int round = 0; round < kUnfoldRounds && again; ++round) {
    again = false;
    now_mm = base_mm;
    for (Eigen::Index i = 0; i < now_mm.cols(); ++i) {
      const auto vertex = static_cast<std::size_t>(i);
      now_mm.col(i) += (moved_mm[vertex] + (kept_mm.empty() ? 0 : kept_mm[vertex])) * normals.col(i);
    }
    mesh::vertex_normals(now_mm, triangles, fine_normals);
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      const auto corner = triangles.col(t);
      const Vector3f across = (now_mm.col(corner[1]) - now_mm.col(corner[0]))
                                  .cross(now_mm.col(corner[2]) - now_mm.col(corner[0]));
      const auto upright = [&](const Matrix3Xf& of) {
        const Vector3f outwards = of.col(corner[0]) + of.col(corner[1]) + of.col(corner[2]);
        return across.dot(outwards) > kLeastUpright * across.norm() * outwards.norm();
      };
      if (!upright(normals) || !upright(fine_normals)) {
        again = true;
        turned += round == 0 ? 1 : 0;
        for (Eigen::Index i = 0; i < 3; ++i) {
          moved_mm[static_cast<std::size_t>(corner[i])] *= 0.5F;
          if (!confidence.empty()) {
            confidence[static_cast<std::size_t>(corner[i])] *= 0.5F;
          }
        }
      }
    }
  }
  return turned;
}

/// The surface without displacements.
void FineSurface::Impl::stand_on(const mesh::Vertices& template_mm) {
  const mesh::Level& fine = hierarchy->finest();
  mesh::apply(fine.from_coarser, template_mm, base_mm);
  mesh::vertex_normals(base_mm, fine.triangles, normals);
}

int FineSurface::Impl::add(const mesh::Vertices& template_mm, std::span<const float> displacements_mm,
                           std::span<const float> added_mm, std::vector<float>& sum_mm) {
  const auto count = static_cast<std::size_t>(hierarchy->finest().vertex_count);
  if (template_mm.cols() != surface->vertex_count() || displacements_mm.size() != count ||
      added_mm.size() != count) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("the fine surface has {} template vertices and {} displacements, not {}, {} and {}",
                    surface->vertex_count(), count, template_mm.cols(), displacements_mm.size(),
                    added_mm.size()));
  }
  stand_on(template_mm);
  sum_mm.assign(added_mm.begin(), added_mm.end());
  const int turned = unfold(displacements_mm, sum_mm, {});
  for (std::size_t i = 0; i < count; ++i) {
    sum_mm[i] += displacements_mm[i];
  }
  return turned;
}

TemplateFitReport FineSurface::Impl::fit(std::span<const capture::DepthMap> maps,
                                         const mesh::Vertices& template_mm,
                                         std::vector<float>& displacements_mm,
                                         std::vector<float>& confidence) {
  const mesh::Level& fine = hierarchy->finest();
  const auto count = static_cast<std::size_t>(fine.vertex_count);
  if (template_mm.cols() != surface->vertex_count() ||
      (!displacements_mm.empty() && displacements_mm.size() != count)) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("the fine surface needs {} template vertices and {} displacements or none, not {} "
                    "and {}",
                    surface->vertex_count(), count, template_mm.cols(), displacements_mm.size()));
  }
  displacements_mm.resize(count, 0.0F);
  confidence.assign(count, 0.0F);
  Eigen::Map<VectorXf> displacement(displacements_mm.data(), fine.vertex_count);
  stand_on(template_mm);
  const double skin = static_cast<double>(std::count(is_skin.begin(), is_skin.end(), std::uint8_t{1}));
  std::vector<Pinhole> cameras;
  for (const capture::DepthMap& map : maps) {
    cameras.emplace_back(map.lens);
  }
  TemplateFitReport report;
  const auto fail = [&](TemplateFitOutcome outcome, std::string failure) {
    displacement.setZero();
    confidence.assign(count, 0.0F);
    report.outcome = outcome;
    report.failure = std::move(failure);
    return report;
  };
  while (report.steps < options.steps) {
    now_mm = base_mm + normals * displacement.asDiagonal();
    mesh::vertex_normals(now_mm, fine.triangles, fine_normals);
    double squares = 0;
    double weights = 0;
    double seen = 0;
    laplacian(displacement, scratch);
    scratch.array() *= static_cast<float>(options.smoothness) * areas.array();
    gradient.setZero();
    add_transposed_laplacian(scratch, gradient);
    for (Eigen::Index i = 0; i < fine.vertex_count; ++i) {
      const auto vertex = static_cast<std::size_t>(i);
      float weight = 0;
      float along = 0;
      float pulled = 0;
      for (std::size_t j = 0; j < maps.size() && is_skin[vertex] != 0; ++j) {
        const auto pull = pull_of(maps[j], cameras[j], now_mm.col(i), fine_normals.col(i),
                                  static_cast<float>(options.sigma_mm));
        if (pull && pull->weight > 0) {
          const float slope = pull->jacobian.dot(normals.col(i));
          weight += pull->weight;
          along += pull->weight * slope * slope;
          pulled += pull->weight * slope * pull->difference_mm;
          squares += static_cast<double>(pull->weight * pull->difference_mm * pull->difference_mm);
          weights += static_cast<double>(pull->weight);
        }
      }
      seen += weight > 0 ? 1 : 0;
      confidence[vertex] = std::min(1.0F, weight);
      const float hold = kHold * (1 - confidence[vertex]);
      blocks[i] = areas[i] * (along + hold);
      gradient[i] += areas[i] * (pulled + hold * displacement[i]);
    }
    report.seen = seen / std::max(skin, 1.0);
    report.surface_rms_mm = weights > 0 ? std::sqrt(squares / weights) : 0;
    if (report.seen < kLeastSeen) {
      return fail(TemplateFitOutcome::NoData,
                  fmt::format("only {:.1f} % of the fine skin lies on a depth map", 100 * report.seen));
    }
    solve_step();
    ++report.steps;
    if (!step.allFinite()) {
      return fail(TemplateFitOutcome::NumericalFailure,
                  fmt::format("step {} of the fine surface is not finite", report.steps));
    }
    displacement += step;
    report.last_move_mm = static_cast<double>(step.cwiseAbs().maxCoeff());
    if (report.last_move_mm < static_cast<double>(kSettledMm)) {
      break;
    }
  }
  unfold({}, displacements_mm, confidence);
  report.outcome = report.last_move_mm < static_cast<double>(kSettledMm) ? TemplateFitOutcome::Converged
                                                                         : TemplateFitOutcome::NotConverged;
  return report;
}

FineSurface::FineSurface(const mesh::ControlMesh& control, std::shared_ptr<const TemplateMesh> surface,
                         const FineOptions& options)
    : impl_(std::make_unique<Impl>(control, std::move(surface), options)) {}
FineSurface::~FineSurface() = default;

const std::shared_ptr<const mesh::Hierarchy>& FineSurface::hierarchy() const {
  return impl_->hierarchy;
}

TemplateFitReport FineSurface::fit(std::span<const capture::DepthMap> maps, const mesh::Vertices& template_mm,
                                   std::vector<float>& displacements_mm, std::vector<float>& confidence) {
  return impl_->fit(maps, template_mm, displacements_mm, confidence);
}

int FineSurface::add(const mesh::Vertices& template_mm, std::span<const float> displacements_mm,
                     std::span<const float> added_mm, std::vector<float>& sum_mm) {
  return impl_->add(template_mm, displacements_mm, added_mm, sum_mm);
}

}  // namespace facet::fit
