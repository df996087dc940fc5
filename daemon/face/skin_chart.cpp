#include "face/skin_chart.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "face/chunk_file.hpp"
#include "facet/error.hpp"

namespace facet::face {
namespace {

constexpr float kStepMm = 0.001F;

/// Chunk 'SKIN'.
struct Grid {
  std::uint32_t width, height;
  float least_u, least_v, texels_per_unit;
};
static_assert(sizeof(Grid) == 20);

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
  return {};
}

std::vector<float> relief_at(const SkinChart& chart, const mesh::TextureCoordinates& coordinates) {
  std::vector<float> out(static_cast<std::size_t>(coordinates.cols()), 0);
  for (std::size_t v = 0; v < out.size(); ++v) {
    const Eigen::Vector2f at =
        chart.texels_per_unit * (coordinates.col(static_cast<Eigen::Index>(v)) - chart.least);
    if (!(at.minCoeff() >= 0) || !(at.x() < static_cast<float>(chart.width - 1)) ||
        !(at.y() < static_cast<float>(chart.height - 1))) {
      continue;
    }
    const Eigen::Vector2f first = at.array().floor();
    const Eigen::Vector2f share = at - first;
    const float* const row = chart.relief_mm.data() + static_cast<std::ptrdiff_t>(first.y()) * chart.width +
                             static_cast<std::ptrdiff_t>(first.x());
    const float* const next = row + chart.width;
    out[v] = (1 - share.y()) * ((1 - share.x()) * row[0] + share.x() * row[1]) +
             share.y() * ((1 - share.x()) * next[0] + share.x() * next[1]);
  }
  return out;
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
}

SkinChart read_skin(const ChunkReader& chunks) {
  SkinChart out;
  if (!chunks.has("SKIN")) {
    if (chunks.has("RELI")) {
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
  const std::string wrong = out.check();
  if (!wrong.empty()) {
    chunks.fail(wrong);
  }
  return out;
}

}  // namespace facet::face
