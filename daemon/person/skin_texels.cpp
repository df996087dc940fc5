#include "person/skin_texels.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include "maths/statistics.hpp"

namespace facet::person {
namespace {

constexpr float kLeastArea = 1e-6F;  ///< squared, mm^4: a texel that is folded together has no gradient

std::vector<char> held_by(const TextureChart& chart) {
  std::vector<char> out(chart.triangle().size());
  std::transform(chart.triangle().begin(), chart.triangle().end(), out.begin(),
                 [](std::int32_t triangle) { return triangle >= 0 ? 1 : 0; });
  return out;
}

}  // namespace

SkinTexels::SkinTexels(const TextureChart& chart, const mesh::Triangles& triangles,
                       const mesh::Vertices& surface_mm)
    : grid(chart.width(), chart.height(), held_by(chart)),
      corners(3, grid.count()),
      shares(3, grid.count()),
      normals(3, grid.count()),
      positions_mm(3, grid.count()),
      along_u(Eigen::Matrix3Xf::Zero(3, grid.count())),
      along_v(Eigen::Matrix3Xf::Zero(3, grid.count())) {
  const mesh::Vertices centred_mm = surface_mm.colwise() - surface_mm.rowwise().mean();
  Eigen::Matrix3Xf vertex_normals;
  mesh::vertex_normals(centred_mm, triangles, vertex_normals);
  for (Eigen::Index i = 0; i < count(); ++i) {
    const auto place = static_cast<std::size_t>(grid.place[static_cast<std::size_t>(i)]);
    corners.col(i) = triangles.col(chart.triangle()[place]).cast<int>();
    shares.col(i) = chart.barycentric()[place];
    positions_mm.col(i) = chart.spread(centred_mm, place);
    normals.col(i) = chart.spread(vertex_normals, place).stableNormalized();
  }
  std::vector<double> lengths;
  for (const std::int32_t i : grid.open) {
    const Eigen::Vector3f u = positions_mm.col(i + 1) - positions_mm.col(i);
    const Eigen::Vector3f v = positions_mm.col(grid.down[static_cast<std::size_t>(i)]) - positions_mm.col(i);
    lengths.push_back(static_cast<double>(u.norm()));
    const float uu = u.squaredNorm();
    const float uv = u.dot(v);
    const float vv = v.squaredNorm();
    const float area = std::max(uu * vv - uv * uv, kLeastArea);
    along_u.col(i) = (vv * u - uv * v) / area;
    along_v.col(i) = (uu * v - uv * u) / area;
  }
  texel_mm = lengths.empty() ? 1 : std::max(maths::median_of(std::move(lengths)), 0.01);
}

cv::Mat SkinTexels::image(const Eigen::ArrayXf& values) const {
  cv::Mat out = cv::Mat::zeros(grid.height, grid.width, CV_32F);
  auto* const pixels = out.ptr<float>();
  for (Eigen::Index i = 0; i < count(); ++i) {
    pixels[grid.place[static_cast<std::size_t>(i)]] = values[i];
  }
  return out;
}

}  // namespace facet::person
