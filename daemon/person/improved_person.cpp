#include "person/improved_person.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "face/person_model.hpp"
#include "maths/alignment.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"
#include "person/surface_anchor.hpp"

namespace facet::person {
namespace {

constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();

/// [vertex_count] 1 / sigma^2; 0 where a solve does not know.
std::vector<float> information_of(const PersonFile& person) {
  std::vector<float> out(static_cast<std::size_t>(person.neutral_mm.cols()), 0);
  for (std::size_t v = 0; v < person.sigma_mm.size(); ++v) {
    const float information = 1 / (person.sigma_mm[v] * person.sigma_mm[v]);
    out[v] = std::isfinite(information) ? information : 0;
  }
  return out;
}

/// [vertex_count] what the second counts as: by information, and beside the skin as the skin there does.
std::vector<float> shares_of(const face::FaceModel& model, const std::vector<float>& before,
                             const std::vector<float>& second) {
  std::vector<float> share(before.size(), kUnknown);
  for (std::size_t v = 0; v < share.size(); ++v) {
    const float both = before[v] + second[v];
    share[v] = both > 0 ? second[v] / both : kUnknown;
  }
  for (bool spreads = true; spreads;) {
    spreads = false;
    std::vector<float> sum(share.size(), 0);
    std::vector<int> count(share.size(), 0);
    for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
      for (int corner = 0; corner < 4; ++corner) {
        const auto from = static_cast<std::size_t>(model.control.quads(corner, q));
        const auto to = static_cast<std::size_t>(model.control.quads((corner + 1) % 4, q));
        for (const auto& [known, unknown] : {std::pair(from, to), std::pair(to, from)}) {
          if (std::isfinite(share[known]) && !std::isfinite(share[unknown])) {
            sum[unknown] += share[known];
            ++count[unknown];
          }
        }
      }
    }
    for (std::size_t v = 0; v < share.size(); ++v) {
      if (count[v] > 0) {
        share[v] = sum[v] / static_cast<float>(count[v]);
        spreads = true;
      }
    }
  }
  return share;
}

/// Median over the skin of the distance along the normal, in standard deviations.
double disagreement_of(const face::FaceModel& model, const std::vector<std::int32_t>& skin,
                       const PersonFile& before, const PersonFile& second, const mesh::Vertices& placed) {
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(before.neutral_mm, mesh::split_quads(model.control.quads), normals);
  const std::vector<float> information_before = information_of(before);
  const std::vector<float> information_second = information_of(second);
  std::vector<double> apart;
  for (const std::int32_t v : skin) {
    const auto i = static_cast<std::size_t>(v);
    if (information_before[i] > 0 && information_second[i] > 0) {
      const float distance = normals.col(v).normalized().dot(placed.col(v) - before.neutral_mm.col(v));
      const float variance = 1 / information_before[i] + 1 / information_second[i];
      apart.push_back(static_cast<double>(std::abs(distance) / std::sqrt(variance)));
    }
  }
  return apart.empty() ? std::numeric_limits<double>::infinity() : maths::median_of(std::move(apart));
}

/// The camera, the gates and the date are the second's; what was seen is both's.
void take_over(const PersonFile& second, PersonFile& person) {
  person.created_utc = second.created_utc;
  person.software = second.software;
  person.keyframes += second.keyframes;
  person.span = {std::min(person.span.least_yaw, second.span.least_yaw),
                 std::max(person.span.largest_yaw, second.span.largest_yaw),
                 std::min(person.span.least_pitch, second.span.least_pitch),
                 std::max(person.span.largest_pitch, second.span.largest_pitch)};
  person.focal_px = second.focal_px;
  person.width_px = second.width_px;
  person.height_px = second.height_px;
  person.gates = second.gates;
}

bool same_grid(const face::SkinChart& a, const face::SkinChart& b) {
  return !a.empty() && a.width == b.width && a.height == b.height && a.least == b.least &&
         a.texels_per_unit == b.texels_per_unit;
}

}  // namespace

ImprovedPerson improved(const face::FaceModel& model, const PersonFile& before, const PersonFile& second) {
  check_model(before, model, before.name);
  check_model(second, model, second.name);
  const std::vector<std::int32_t> skin = free_skin(model).skin;
  const maths::Similarity onto =
      maths::best_similarity(second.neutral_mm(Eigen::all, skin), before.neutral_mm(Eigen::all, skin), true);
  const mesh::Vertices placed = onto.apply(second.neutral_mm);

  ImprovedPerson out;
  out.person = before;
  out.disagreement = disagreement_of(model, skin, before, second, placed);
  out.same_head = out.disagreement <= kSameHead;
  if (!out.same_head) {
    return out;
  }
  const std::vector<float> information_before = information_of(before);
  const std::vector<float> information_second = information_of(second);
  const std::vector<float> share = shares_of(model, information_before, information_second);
  Eigen::Matrix3Xd neutral_mm = before.neutral_mm.cast<double>();
  out.person.sigma_mm.assign(share.size(), kUnknown);
  for (std::size_t i = 0; i < share.size(); ++i) {
    const auto v = static_cast<Eigen::Index>(i);
    if (std::isfinite(share[i])) {
      neutral_mm.col(v) +=
          static_cast<double>(share[i]) * (placed.col(v) - before.neutral_mm.col(v)).cast<double>();
    }
    // Both rest on the same model: what they err by together does not fall.
    const float information = share[i] * information_second[i] + (1 - share[i]) * information_before[i];
    out.person.sigma_mm[i] = information > 0 ? 1 / std::sqrt(information) : kUnknown;
  }
  double second_counts = 0;
  for (const std::int32_t v : skin) {
    second_counts +=
        static_cast<double>(share[static_cast<std::size_t>(v)]) / static_cast<double>(skin.size());
  }
  const bool more = before.skin.albedo.empty() && !second.skin.albedo.empty();
  if (before.skin.empty() || more || (second_counts > 0.5 && !second.skin.empty())) {
    out.person.skin = second.skin;
  }
  if (same_grid(before.skin, second.skin)) {
    // Each errs as its light led it.
    const auto counts = static_cast<float>(second_counts);
    std::transform(before.skin.relief_mm.begin(), before.skin.relief_mm.end(), second.skin.relief_mm.begin(),
                   out.person.skin.relief_mm.begin(),
                   [&](float first, float other) { return first + counts * (other - first); });
  }
  face::bring_loose_pieces(model, before.neutral_mm.cast<double>(), neutral_mm);
  out.person.neutral_mm = neutral_mm.cast<float>();
  take_over(second, out.person);
  return out;
}

}  // namespace facet::person
