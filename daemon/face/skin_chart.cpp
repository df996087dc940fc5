#include "face/skin_chart.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>

#include "face/chunk_file.hpp"
#include "facet/error.hpp"
#include "mesh/triangle_points.hpp"

namespace facet::face {
namespace {

constexpr float kStepMm = 0.001F;
constexpr float kRootSteps = 255;  ///< of an albedo's square root: dark skin as finely as fair

/// Chunk 'SKIN'.
struct Grid {
  std::uint32_t width, height;
  float least_u, least_v, texels_per_unit;
};
static_assert(sizeof(Grid) == 20);

/// Four texels about a place, and what each counts as.
struct Place {
  std::array<std::size_t, 4> texels;
  std::array<float, 4> shares;
};

/// Nothing beyond the chart.
std::optional<Place> place_of(const SkinChart& chart, const Eigen::Vector2f& coordinates) {
  const Eigen::Vector2f at = chart.texels_per_unit * (coordinates - chart.least);
  if (!(at.minCoeff() >= 0) || !(at.x() < static_cast<float>(chart.width - 1)) ||
      !(at.y() < static_cast<float>(chart.height - 1))) {
    return std::nullopt;
  }
  const Eigen::Vector2f first = at.array().floor();
  const Eigen::Vector2f share = at - first;
  const auto width = static_cast<std::size_t>(chart.width);
  const std::size_t texel = static_cast<std::size_t>(first.y()) * width + static_cast<std::size_t>(first.x());
  return Place{{texel, texel + 1, texel + width, texel + width + 1},
               {(1 - share.y()) * (1 - share.x()), (1 - share.y()) * share.x(), share.y() * (1 - share.x()),
                share.y() * share.x()}};
}

}  // namespace

std::string SkinChart::check() const {
  if (width < 1 || height < 1 || width > kMostChartTexels || height > kMostChartTexels) {
    return fmt::format("its skin has {}x{} texels (allowed: 1 to {} a side)", width, height,
                       kMostChartTexels);
  }
  if (!least.allFinite() || !(texels_per_unit > 0) || !std::isfinite(texels_per_unit)) {
    return "its skin lies nowhere on the texture chart";
  }
  if (relief_mm.size() != static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) {
    return fmt::format("its skin has {} texels of relief, not {}x{}", relief_mm.size(), width, height);
  }
  if (std::any_of(relief_mm.begin(), relief_mm.end(),
                  [](float mm) { return !(std::abs(mm) <= kMostReliefMm); })) {
    return fmt::format("its skin's relief is not finite or beyond {} mm", kMostReliefMm);
  }
  if (!albedo.empty() && albedo.size() != 3 * relief_mm.size()) {
    return fmt::format("its skin has {} numbers of albedo, not 3 of each of {}x{} texels", albedo.size(),
                       width, height);
  }
  if (std::any_of(albedo.begin(), albedo.end(), [](float rgb) { return !(rgb >= 0 && rgb <= 1); })) {
    return "its skin's albedo is not within 0 and 1";
  }
  return {};
}

std::vector<float> relief_at(const SkinChart& chart, const mesh::TextureCoordinates& coordinates) {
  std::vector<float> out(static_cast<std::size_t>(coordinates.cols()), 0);
  for (std::size_t v = 0; v < out.size(); ++v) {
    if (const auto at = place_of(chart, coordinates.col(static_cast<Eigen::Index>(v)))) {
      for (std::size_t corner = 0; corner < 4; ++corner) {
        out[v] += at->shares[corner] * chart.relief_mm[at->texels[corner]];
      }
    }
  }
  return out;
}

mesh::Vertices albedo_at(const SkinChart& chart, const mesh::TextureCoordinates& coordinates,
                         const mesh::Vertices& elsewhere) {
  if (chart.albedo.empty()) {
    return {};
  }
  mesh::Vertices out = mesh::Vertices::Zero(3, coordinates.cols());
  std::vector<bool> known(static_cast<std::size_t>(coordinates.cols()), false);
  Eigen::Array3f found = Eigen::Array3f::Zero();
  Eigen::Array3f usual = Eigen::Array3f::Zero();
  for (Eigen::Index v = 0; v < out.cols(); ++v) {
    const auto at = place_of(chart, coordinates.col(v));
    bool whole = at.has_value();
    for (std::size_t corner = 0; whole && corner < 4; ++corner) {
      const Eigen::Map<const Eigen::Vector3f> rgb(chart.albedo.data() + 3 * at->texels[corner]);
      whole = rgb.maxCoeff() > 0 || at->shares[corner] <= 0;
      out.col(v) += at->shares[corner] * rgb;
    }
    if (whole) {
      known[static_cast<std::size_t>(v)] = true;
      found += out.col(v).array();
      usual += elsewhere.col(v).array();
    }
  }
  const Eigen::Array3f tint = usual.minCoeff() > 0 ? (found / usual).eval() : Eigen::Array3f::Ones();
  for (Eigen::Index v = 0; v < out.cols(); ++v) {
    if (!known[static_cast<std::size_t>(v)]) {
      out.col(v) = tint * elsewhere.col(v).array();
    }
  }
  return out;
}

void add_relief(const mesh::Triangles& triangles, const mesh::TextureCoordinates& coordinates,
                const std::vector<float>& more_mm, SkinChart& chart) {
  // Neighbours share texels of an edge: what they say there is one and the same.
  std::vector<float> more(chart.relief_mm.size(), 0);
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto corners = triangles.col(t);
    const auto texel = [&](int corner) -> Eigen::Vector2f {
      return chart.texels_per_unit * (coordinates.col(corners[corner]) - chart.least);
    };
    const auto at = [&](int corner) { return more_mm[static_cast<std::size_t>(corners[corner])]; };
    if (at(0) == 0 && at(1) == 0 && at(2) == 0) {
      continue;  // what is not refined may lie on the chart more than once
    }
    mesh::for_each_point(texel(0), texel(1), texel(2), chart.width, chart.height,
                         [&](int x, int y, const Eigen::Vector3f& share) {
                           more[static_cast<std::size_t>(y) * static_cast<std::size_t>(chart.width) +
                                static_cast<std::size_t>(x)] =
                               share[0] * at(0) + share[1] * at(1) + share[2] * at(2);
                         });
  }
  std::transform(
      more.begin(), more.end(), chart.relief_mm.begin(), chart.relief_mm.begin(),
      [](float added, float relief) { return std::clamp(relief + added, -kMostReliefMm, kMostReliefMm); });
}

void add_skin(const SkinChart& chart, ChunkWriter& writer) {
  if (chart.empty()) {
    return;
  }
  if (const std::string wrong = chart.check(); !wrong.empty()) {
    throw Error(ErrorKind::Internal, "it can't be saved: " + wrong);
  }
  const Grid grid{static_cast<std::uint32_t>(chart.width), static_cast<std::uint32_t>(chart.height),
                  chart.least.x(), chart.least.y(), chart.texels_per_unit};
  std::vector<std::int16_t> steps(chart.relief_mm.size());
  std::transform(chart.relief_mm.begin(), chart.relief_mm.end(), steps.begin(),
                 [](float mm) { return static_cast<std::int16_t>(std::lround(mm / kStepMm)); });
  writer.add("SKIN", bytes_of(&grid, 1), false);
  writer.add("RELI", bytes_of(steps.data(), steps.size()), true);
  if (!chart.albedo.empty()) {
    std::vector<std::uint8_t> codes(chart.albedo.size());
    std::transform(chart.albedo.begin(), chart.albedo.end(), codes.begin(), [](float rgb) {
      return static_cast<std::uint8_t>(std::lround(kRootSteps * std::sqrt(rgb)));
    });
    writer.add("TONE", bytes_of(codes.data(), codes.size()), true);
  }
}

SkinChart read_skin(const ChunkReader& chunks) {
  SkinChart out;
  if (!chunks.has("SKIN")) {
    if (chunks.has("RELI") || chunks.has("TONE")) {
      chunks.fail("chunk 'SKIN' is missing");
    }
    return out;
  }
  Grid grid{};
  chunks.read("SKIN", &grid, 1);
  constexpr auto kMost = static_cast<std::uint32_t>(kMostChartTexels);
  if (grid.width < 1 || grid.height < 1 || grid.width > kMost || grid.height > kMost) {
    chunks.fail(fmt::format("its skin has {}x{} texels (allowed: 1 to {} a side)", grid.width, grid.height,
                            kMostChartTexels));
  }
  out.width = static_cast<int>(grid.width);
  out.height = static_cast<int>(grid.height);
  out.least = {grid.least_u, grid.least_v};
  out.texels_per_unit = grid.texels_per_unit;
  const std::size_t texels = static_cast<std::size_t>(grid.width) * grid.height;
  chunks.expect_plausible("RELI", texels * sizeof(std::int16_t));
  std::vector<std::int16_t> steps(texels);
  chunks.read("RELI", steps.data(), steps.size());
  out.relief_mm.resize(steps.size());
  std::transform(steps.begin(), steps.end(), out.relief_mm.begin(),
                 [](std::int16_t step) { return kStepMm * static_cast<float>(step); });
  if (chunks.has("TONE")) {
    chunks.expect_plausible("TONE", 3 * texels);
    std::vector<std::uint8_t> codes(3 * texels);
    chunks.read("TONE", codes.data(), codes.size());
    out.albedo.resize(codes.size());
    std::transform(codes.begin(), codes.end(), out.albedo.begin(), [](std::uint8_t code) {
      const float root = static_cast<float>(code) / kRootSteps;
      return root * root;
    });
  }
  const std::string wrong = out.check();
  if (!wrong.empty()) {
    chunks.fail(wrong);
  }
  return out;
}

}  // namespace facet::face
