#include "refine/subject_setup.hpp"

#include <fmt/format.h>

#include <cstddef>

#include "facet/error.hpp"
#include "refine/level_buffers.hpp"

namespace facet::refine {

using shaders::vec4;

std::vector<mesh::Vertices> mean_albedo_of_levels(const SubjectSetup& subject) {
  std::vector<mesh::Vertices> out;
  mesh::push_positions(*subject.hierarchy, subject.mean_albedo, out);
  return out;
}

std::vector<mesh::Vertices> known_albedo_of_levels(const SubjectSetup& subject) {
  const std::vector<mesh::Level>& levels = subject.hierarchy->levels;
  std::vector<mesh::Vertices> out(levels.size());
  out.back() =
      Eigen::Map<const mesh::Vertices>(subject.albedo->linear_rgb.data(), 3, levels.back().vertex_count);
  for (std::size_t l = levels.size() - 1; l > 0; --l) {
    const mesh::OneRings& rings = levels[l].one_rings;
    out[l - 1].resize(3, levels[l - 1].vertex_count);
    for (Eigen::Index v = 0; v < out[l - 1].cols(); ++v) {
      const auto first = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)]);
      const auto end = static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v) + 1]);
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      for (std::size_t k = first; k < end; ++k) {
        sum += out[l].col(rings.neighbours[k]);
      }
      out[l - 1].col(v) = 0.5F * out[l].col(v) + 0.5F * sum / static_cast<float>(end - first);
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
