#include "face/face_model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace facet::face {
namespace {

/// Weights of one mode: the mean (or neutral) first with weight 1, then the given ones, then zeros.
std::vector<float> with_constant(std::span<const float> weights, int mode_count) {
  std::vector<float> all(static_cast<std::size_t>(mode_count), 0.0F);
  if (all.empty()) {
    return all;
  }
  all[0] = 1.0F;
  const std::size_t given = std::min(weights.size(), all.size() - 1);
  std::copy_n(weights.begin(), given, all.begin() + 1);
  return all;
}

bool all_finite(const float* values, std::size_t count) {
  // A product with 0 is NaN exactly where a value is not finite, and the loop vectorises.
  float sum = 0;
  for (std::size_t i = 0; i < count; ++i) {
    sum += values[i] * 0.0F;
  }
  return std::isfinite(sum);
}

bool all_finite(const std::vector<float>& values) {
  return all_finite(values.data(), values.size());
}

/// Indices out of [0, vertex_count).
template <typename Indices>
bool out_of_range(const Indices& indices, std::int32_t vertex_count) {
  return std::any_of(indices.begin(), indices.end(),
                     [=](std::int32_t index) { return index < 0 || index >= vertex_count; });
}

std::string check_landmarks(const FaceModel& model) {
  constexpr float kWeightSumTolerance = 1e-3F;
  if (!model.landmarks.empty() && model.landmarks.size() != FaceModel::kLandmarkCount) {
    return fmt::format("it has {} landmarks (allowed: 0 or {})", model.landmarks.size(),
                       FaceModel::kLandmarkCount);
  }
  for (std::size_t i = 0; i < model.landmarks.size(); ++i) {
    const LandmarkAnchor& anchor = model.landmarks[i];
    if (out_of_range(anchor.vertices, model.control.vertex_count)) {
      return fmt::format("landmark {} names a vertex that is not there", i);
    }
    const float sum = anchor.weights[0] + anchor.weights[1] + anchor.weights[2];
    const bool no_place = std::all_of(anchor.weights.begin(), anchor.weights.end(),
                                      [](float weight) { return weight == 0.0F; });
    if (!no_place && !(std::abs(sum - 1.0F) <= kWeightSumTolerance && all_finite(anchor.weights.data(), 3))) {
      return fmt::format("the weights of landmark {} sum to {} (allowed: 1, or all 0)", i, sum);
    }
  }
  return {};
}

std::string check_expressions(const FaceModel& model) {
  if (model.expression_modes != model.expression_count() + 1) {
    return fmt::format("{} expression modes but {} names", model.expression_modes, model.expression_count());
  }
  if (model.expression_sigma.size() != model.expression_names.size()) {
    return fmt::format("{} expression names but {} sizes", model.expression_names.size(),
                       model.expression_sigma.size());
  }
  std::set<std::string_view> seen;
  for (const std::string& name : model.expression_names) {
    if (name.empty() || !seen.insert(name).second) {
      return fmt::format("the expression name '{}' is empty or used twice", name);
    }
  }
  if (!all_finite(model.expression_sigma) ||
      std::any_of(model.expression_sigma.begin(), model.expression_sigma.end(),
                  [](float sigma) { return sigma <= 0; })) {
    return "an expression's typical size is not a positive number";
  }
  return {};
}

}  // namespace

void ExpressionBasis::evaluate(std::span<const float> expression, mesh::Vertices& vertices_mm) const {
  vertices_mm = neutral_mm;
  const std::size_t count = std::min(expression.size(), deltas_mm.size());
  for (std::size_t e = 0; e < count; ++e) {
    if (expression[e] != 0.0F) {
      vertices_mm.noalias() += expression[e] * deltas_mm[e];
    }
  }
}

void FaceModel::evaluate(std::span<const float> identity, std::span<const float> expression,
                         mesh::Vertices& vertices_mm) const {
  const std::vector<float> w_id = with_constant(identity, identity_modes);
  const std::vector<float> w_exp = with_constant(expression, expression_modes);
  vertices_mm.setZero(3, control.vertex_count);
  for (int i = 0; i < identity_modes; ++i) {
    for (int e = 0; e < expression_modes; ++e) {
      const float weight = w_id[static_cast<std::size_t>(i)] * w_exp[static_cast<std::size_t>(e)];
      if (weight != 0.0F) {
        vertices_mm.noalias() += weight * core_row(i, e);
      }
    }
  }
}

ExpressionBasis FaceModel::contract_identity(std::span<const float> identity) const {
  const std::vector<float> w_id = with_constant(identity, identity_modes);
  ExpressionBasis basis;
  basis.deltas_mm.resize(static_cast<std::size_t>(expression_count()));
  for (int e = 0; e < expression_modes; ++e) {
    mesh::Vertices& sum = e == 0 ? basis.neutral_mm : basis.deltas_mm[static_cast<std::size_t>(e - 1)];
    sum = core_row(0, e);
    for (int i = 1; i < identity_modes; ++i) {
      if (w_id[static_cast<std::size_t>(i)] != 0.0F) {
        sum.noalias() += w_id[static_cast<std::size_t>(i)] * core_row(i, e);
      }
    }
  }
  return basis;
}

int FaceModel::expression_index(std::string_view expression) const {
  const auto found = std::find(expression_names.begin(), expression_names.end(), expression);
  return found == expression_names.end() ? -1 : static_cast<int>(found - expression_names.begin());
}

std::vector<Eigen::MatrixXf> FaceModel::core_at(std::span<const int> landmark_indices) const {
  std::vector<Eigen::MatrixXf> rows;
  rows.reserve(landmark_indices.size());
  for (const int index : landmark_indices) {
    Eigen::MatrixXf& at =
        rows.emplace_back(Eigen::MatrixXf::Zero(Eigen::Index{3} * identity_modes, expression_modes));
    const LandmarkAnchor& anchor = landmarks.at(static_cast<std::size_t>(index));
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (anchor.weights[corner] == 0.0F) {
        continue;
      }
      for (int i = 0; i < identity_modes; ++i) {
        for (int e = 0; e < expression_modes; ++e) {
          at.block<3, 1>(Eigen::Index{3} * i, e) +=
              anchor.weights[corner] * core_row(i, e).col(anchor.vertices[corner]);
        }
      }
    }
  }
  return rows;
}

std::string FaceModel::check() const {
  const auto vertices = static_cast<std::size_t>(std::max(control.vertex_count, 0));
  if (control.vertex_count < 3 || control.quads.cols() < 1) {
    return fmt::format("it has {} vertices and {} quads", control.vertex_count, control.quads.cols());
  }
  if (out_of_range(control.quads.reshaped(), control.vertex_count)) {
    return "a quad names a vertex that is not there";
  }
  if (static_cast<std::size_t>(control.texture_coordinates.cols()) != vertices ||
      control.refinable.size() != vertices || regions.size() != vertices ||
      static_cast<std::size_t>(mean_albedo.cols()) != vertices) {
    return "texture coordinates, regions or albedo do not have one entry per vertex";
  }
  if (!all_finite(control.texture_coordinates.data(), 2 * vertices) ||
      !all_finite(mean_albedo.data(), 3 * vertices)) {
    return "a texture coordinate or albedo is not a finite number";
  }
  if (identity_modes < 1 || expression_modes < 1) {
    return fmt::format("it has {} identity and {} expression modes", identity_modes, expression_modes);
  }
  if (core_mm.size() !=
      static_cast<std::size_t>(identity_modes) * static_cast<std::size_t>(expression_modes) * vertices * 3) {
    return fmt::format(
        "its core has {} numbers, which is not identity modes x expression modes x vertices x 3",
        core_mm.size());
  }
  if (!all_finite(core_mm)) {
    return "a number of the core is not finite";
  }
  std::string wrong = check_expressions(*this);
  if (wrong.empty()) {
    wrong = check_landmarks(*this);
  }
  return wrong.empty() && !skin.empty() ? skin.check() : wrong;
}

}  // namespace facet::face
