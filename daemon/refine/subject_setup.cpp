#include "refine/subject_setup.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>

#include "facet/error.hpp"
#include "refine/level_buffers.hpp"

namespace facet::refine {

using shaders::vec4;

namespace {

constexpr float kLeastAlbedo = 1e-3F;
constexpr float kMostAlbedo = 1.2F;  ///< as albedo_normalise.comp has it
/// Of smoothing on M0, about 15 mm of the default model's: what is finer in the albedo of a turn is furrows
/// as well.
constexpr int kToneRounds = 16;

/// [n] mean of the ring's columns of values.
Eigen::VectorXf ring_mean(const mesh::OneRings& rings, const Eigen::MatrixXf& values, Eigen::Index vertex) {
  const auto first = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(vertex)]);
  const auto end = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(vertex) + 1]);
  Eigen::VectorXf sum = Eigen::VectorXf::Zero(values.rows());
  for (std::size_t k = first; k < end; ++k) {
    sum += values.col(rings.neighbours[k]);
  }
  return sum / static_cast<float>(std::max<std::size_t>(1, end - first));
}

/// Values of every level from the finest one's, [n][vertex_count].
std::vector<Eigen::MatrixXf> restricted(const mesh::Hierarchy& hierarchy, Eigen::MatrixXf finest) {
  const std::vector<mesh::Level>& levels = hierarchy.levels;
  std::vector<Eigen::MatrixXf> out(levels.size());
  out.back() = std::move(finest);
  for (std::size_t l = levels.size() - 1; l > 0; --l) {
    out[l - 1].resize(out[l].rows(), levels[l - 1].vertex_count);
    for (Eigen::Index v = 0; v < out[l - 1].cols(); ++v) {
      out[l - 1].col(v) = 0.5F * out[l].col(v) + 0.5F * ring_mean(levels[l].one_rings, out[l], v);
    }
  }
  return out;
}

/// What is wider than kToneRounds say of an albedo of M0 over another, onto that one.
mesh::Vertices in_tone(const mesh::OneRings& rings, const mesh::Vertices& of, const mesh::Vertices& onto) {
  Eigen::MatrixXf tone = (of.array().max(kLeastAlbedo) / onto.array().max(kLeastAlbedo)).log();
  Eigen::MatrixXf smoother = tone;
  for (int round = 0; round < kToneRounds; ++round) {
    for (Eigen::Index v = 0; v < tone.cols(); ++v) {
      smoother.col(v) = 0.5F * tone.col(v) + 0.5F * ring_mean(rings, tone, v);
    }
    tone.swap(smoother);
  }
  return onto.array() * tone.array().exp();
}

}  // namespace

std::vector<mesh::Vertices> albedo_of_levels(const SubjectSetup& subject) {
  const mesh::Hierarchy& hierarchy = *subject.hierarchy;
  if (subject.albedo != nullptr) {
    const std::vector<Eigen::MatrixXf> found =
        restricted(hierarchy, Eigen::Map<const mesh::Vertices>(subject.albedo->linear_rgb.data(), 3,
                                                               hierarchy.finest().vertex_count));
    return {found.begin(), found.end()};
  }
  std::vector<mesh::Vertices> out;
  mesh::push_positions(hierarchy, subject.mean_albedo, out);
  if (subject.skin_albedo.cols() > 0) {
    out.front() = in_tone(hierarchy.levels.front().one_rings,
                          restricted(hierarchy, subject.skin_albedo).front(), out.front());
    for (std::size_t l = 1; l < out.size(); ++l) {
      mesh::apply(hierarchy.levels[l].from_coarser, out[l - 1], out[l]);
    }
  }
  return out;
}

void take_hue(const mesh::Vertices& skin, std::span<const float> counts, std::vector<float>& linear_rgb) {
  Eigen::Map<mesh::Vertices> taught(linear_rgb.data(), 3, skin.cols());
  const Eigen::Map<const Eigen::VectorXf> weights(counts.data(), skin.cols());
  const Eigen::Array3f known = (skin * weights).array();
  const Eigen::Array3f hue =
      known.minCoeff() > 0 ? ((taught * weights).array() / known).eval() : Eigen::Array3f::Ones();
  taught = (skin.array().colwise() * hue).min(kMostAlbedo);
}

std::vector<mesh::Vertices> relief_of_levels(const SubjectSetup& subject) {
  if (subject.relief_mm.empty()) {
    return {};
  }
  const std::vector<mesh::Level>& levels = subject.hierarchy->levels;
  std::vector<Eigen::MatrixXf> relief = restricted(
      *subject.hierarchy,
      Eigen::Map<const Eigen::RowVectorXf>(subject.relief_mm.data(), std::ssize(subject.relief_mm)));
  const std::vector<std::vector<std::uint8_t>> free = free_vertices(*subject.hierarchy, subject.refinable);
  std::vector<mesh::Vertices> out(levels.size());
  for (std::size_t l = 0; l < levels.size(); ++l) {
    for (Eigen::Index v = 0; v < relief[l].cols(); ++v) {
      relief[l](0, v) *= free[l][static_cast<std::size_t>(v)] != 0 ? 1.0F : 0.0F;
    }
    Eigen::MatrixXf coarser = Eigen::RowVectorXf::Zero(relief[l].cols());
    if (l > 0) {
      mesh::apply(levels[l].from_coarser, relief[l - 1], coarser);
    }
    out[l].resize(3, relief[l].cols());
    for (Eigen::Index v = 0; v < relief[l].cols(); ++v) {
      const float own = relief[l](0, v);
      out[l].col(v) << own, own - ring_mean(levels[l].one_rings, relief[l], v)[0], own - coarser(0, v);
    }
  }
  return out;
}

std::vector<float> counts_for_light(const SubjectSetup& subject) {
  const std::vector<std::uint8_t> free = free_vertices(*subject.hierarchy, subject.refinable).front();
  std::vector<float> out(free.begin(), free.end());
  if (!subject.trust.empty()) {
    const std::vector<float> trust = trust_of_levels(*subject.hierarchy, subject.trust).front();
    for (std::size_t v = 0; v < out.size(); ++v) {
      out[v] *= trust[v];
    }
  }
  return out;
}

std::vector<vec4> with_fourth(const mesh::Vertices& columns, float fourth) {
  std::vector<vec4> out(static_cast<std::size_t>(columns.cols()));
  for (std::size_t i = 0; i < out.size(); ++i) {
    const auto column = static_cast<Eigen::Index>(i);
    out[i] = {columns(0, column), columns(1, column), columns(2, column), fourth};
  }
  return out;
}

void check(const RefinerConfig& config, const SubjectSetup& subject) {
  if (subject.hierarchy == nullptr || subject.hierarchy->levels.empty()) {
    throw Error(ErrorKind::Usage, "refinement needs a subject with a hierarchy");
  }
  if (config.given_prior && (subject.hierarchy->levels.size() != 1 || !config.hierarchical)) {
    throw Error(ErrorKind::Usage,
                "given displacements are refined on one level: the subject's hierarchy has more");
  }
  const std::int32_t count = subject.hierarchy->control_vertex_count;
  if (subject.mean_albedo.cols() != count || subject.refinable.size() != static_cast<std::size_t>(count)) {
    throw Error(ErrorKind::Usage,
                fmt::format("the subject has {} control vertices, {} mean albedos and {} refinable "
                            "flags; the three must be equal",
                            count, subject.mean_albedo.cols(), subject.refinable.size()));
  }
  if (!subject.trust.empty() && subject.trust.size() != static_cast<std::size_t>(count)) {
    throw Error(ErrorKind::Usage, fmt::format("the subject has {} control vertices and trust for {}", count,
                                              subject.trust.size()));
  }
  const auto finest = static_cast<std::size_t>(subject.hierarchy->finest().vertex_count);
  if (config.given_prior && !subject.relief_mm.empty()) {
    throw Error(ErrorKind::Usage, "given displacements and a known relief would both be added");
  }
  if (!subject.relief_mm.empty() && subject.relief_mm.size() != finest) {
    throw Error(ErrorKind::Usage, fmt::format("the known relief has {} numbers; the finest level needs {}",
                                              subject.relief_mm.size(), finest));
  }
  const auto skin = static_cast<std::size_t>(subject.skin_albedo.cols());
  if (skin != 0 && (skin != finest || subject.albedo != nullptr || !subject.skin_albedo.allFinite())) {
    throw Error(ErrorKind::Usage, fmt::format("the skin's albedo has {} colours; the finest level needs {}, "
                                              "finite, and no other known albedo beside it",
                                              skin, finest));
  }
  if (static_cast<std::size_t>(subject.hierarchy->texture_coordinates.cols()) != finest) {
    throw Error(ErrorKind::Usage,
                fmt::format("the subject's finest level has {} vertices and {} texture coordinates", finest,
                            subject.hierarchy->texture_coordinates.cols()));
  }
  if (subject.albedo != nullptr && subject.albedo->linear_rgb.size() != 3 * finest) {
    throw Error(ErrorKind::Usage, fmt::format("the known albedo has {} numbers; the finest level needs {}",
                                              subject.albedo->linear_rgb.size(), 3 * finest));
  }
}

}  // namespace facet::refine
