#include "fit/projected_light.hpp"

#include <cmath>
#include <utility>

namespace facet::fit {
namespace {

using Eigen::Vector3f;

constexpr float kReference_mm = 1000;  ///< where a projector gives 1
constexpr float kLift_mm = 1;          ///< off the skin, so that it does not shadow itself
constexpr float kMargin_mm = 1;        ///< behind what a projector sees: in its shadow

}  // namespace

ProjectedLight::ProjectedLight(std::vector<capture::Lens> projectors) {
  for (capture::Lens& lens : projectors) {
    const Vector3f centre_mm = lens.centre_mm().cast<float>();
    const Pinhole pinhole(lens);
    projectors_.push_back({std::move(lens), pinhole, centre_mm, {}});
  }
}

void ProjectedLight::cast_shadows(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles) {
  for (Projector& projector : projectors_) {
    const Pinhole& pinhole = projector.pinhole;
    projector.seen.draw(projector.lens, (pinhole.rotation * vertices_mm).colwise() + pinhole.translation,
                        triangles);
  }
}

float ProjectedLight::at(const Vector3f& point_mm, const Vector3f& normal) const {
  float sum = 0;
  for (const Projector& projector : projectors_) {
    const Vector3f way = projector.centre_mm - point_mm;
    const float distance = way.norm();
    const float cosine = normal.dot(way) / distance;
    if (!(cosine > 0)) {
      continue;
    }
    const Pinhole& pinhole = projector.pinhole;
    const Vector3f seen = pinhole.rotation * (point_mm + kLift_mm * normal) + pinhole.translation;
    if (!(seen.z() > 1)) {
      continue;
    }
    const float x = pinhole.fx * seen.x() / seen.z() + pinhole.cx;
    const float y = pinhole.fy * seen.y() / seen.z() + pinhole.cy;
    // Between four pixels: the share of them that is lit.
    const float left = std::floor(x);
    const float top = std::floor(y);
    const float u = x - left;
    const float v = y - top;
    const auto lit = [&](float column, float row) {
      const float nearest = projector.seen.at(column, row);
      return nearest > 0 && seen.z() < nearest + kMargin_mm ? 1.0F : 0.0F;
    };
    const float share = (lit(left, top) * (1 - u) + lit(left + 1, top) * u) * (1 - v) +
                        (lit(left, top + 1) * (1 - u) + lit(left + 1, top + 1) * u) * v;
    const float thinning = kReference_mm / distance;
    sum += share * cosine * thinning * thinning;
  }
  return sum;
}

}  // namespace facet::fit
