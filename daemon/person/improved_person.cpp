#include "person/improved_person.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "facet/error.hpp"
#include "maths/alignment.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/surface_anchor.hpp"

namespace facet::person {
namespace {

void check_model(const face::FaceModel& model, const PersonFile& person) {
  if (person.model_checksum != model_checksum(model) || person.neutral_mm.cols() != model.vertex_count()) {
    throw Error(ErrorKind::Usage, fmt::format("'{}' was enrolled with the face model '{}', not with '{}'",
                                              person.name, person.model_name, model.name));
  }
}

/// [vertex_count] a solve's standard deviation, NaN where it does not know.
std::vector<float> sigma_of(const PersonFile& person) {
  return person.sigma_mm.empty() ? std::vector<float>(static_cast<std::size_t>(person.neutral_mm.cols()),
                                                      std::numeric_limits<float>::quiet_NaN())
                                 : person.sigma_mm;
}

}  // namespace

ImprovedPerson improved(const face::FaceModel& model, const PersonFile& before, const PersonFile& second) {
  check_model(model, before);
  check_model(model, second);
  const std::vector<float> sigma_before = sigma_of(before);
  const std::vector<float> sigma_second = sigma_of(second);
  const FreeSkin skin = free_skin(model);
  const maths::Similarity onto = maths::best_similarity(second.neutral_mm(Eigen::all, skin.skin),
                                                        before.neutral_mm(Eigen::all, skin.skin), true);
  const mesh::Vertices placed = onto.apply(second.neutral_mm);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(before.neutral_mm, mesh::split_quads(model.control.quads), normals);

  ImprovedPerson out;
  out.person = before;
  std::vector<double> apart;
  for (const std::int32_t v : skin.skin) {
    const auto i = static_cast<std::size_t>(v);
    const double sigma = std::hypot(sigma_before[i], sigma_second[i]);
    if (std::isfinite(sigma) && sigma > 0) {
      apart.push_back(static_cast<double>(std::abs(
                          normals.col(v).normalized().dot(placed.col(v) - before.neutral_mm.col(v)))) /
                      sigma);
    }
  }
  out.disagreement =
      apart.empty() ? std::numeric_limits<double>::infinity() : maths::median_of(std::move(apart));
  out.same_head = out.disagreement <= kSameHead;
  if (!out.same_head) {
    return out;
  }
  std::vector<float> sigma(sigma_before.size(), std::numeric_limits<float>::quiet_NaN());
  for (Eigen::Index v = 0; v < model.vertex_count(); ++v) {
    const auto i = static_cast<std::size_t>(v);
    const float information_before = 1 / (sigma_before[i] * sigma_before[i]);
    const float information_second = 1 / (sigma_second[i] * sigma_second[i]);
    const float information = information_before + information_second;
    const bool known = std::isfinite(information);
    const float share = known ? information_second / information : 0.5F;
    // Both rest on the same model: what they err by together does not fall.
    sigma[i] =
        known ? 1 / std::sqrt(share * information_second + (1 - share) * information_before) : sigma[i];
    out.person.neutral_mm.col(v) += share * (placed.col(v) - before.neutral_mm.col(v));
  }
  out.person.sigma_mm = std::move(sigma);
  out.person.created_utc = second.created_utc;
  out.person.software = second.software;
  out.person.keyframes = before.keyframes + second.keyframes;
  out.person.span = {std::min(before.span.least_yaw, second.span.least_yaw),
                     std::max(before.span.largest_yaw, second.span.largest_yaw),
                     std::min(before.span.least_pitch, second.span.least_pitch),
                     std::max(before.span.largest_pitch, second.span.largest_pitch)};
  out.person.focal_px = second.focal_px;
  out.person.width_px = second.width_px;
  out.person.height_px = second.height_px;
  out.person.gates = second.gates;
  return out;
}

}  // namespace facet::person
