#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

namespace facet::mesh {

/// Calls at(x, y, barycentric) for every whole point (x, y) within a triangle and the bounds [0, width) x [0,
/// height).
template <typename At>
void for_each_point(const Eigen::Vector2f& a, const Eigen::Vector2f& b, const Eigen::Vector2f& c, int width,
                    int height, At&& at) {
  const Eigen::Vector2f ab = b - a;
  const Eigen::Vector2f ac = c - a;
  const float doubled_area = ab.x() * ac.y() - ac.x() * ab.y();
  if (!(std::abs(doubled_area) > 1e-9F)) {
    return;
  }
  const auto first = [](float least) { return std::max(0, static_cast<int>(std::ceil(least))); };
  const auto last = [](float most, int end) { return std::min(end - 1, static_cast<int>(std::floor(most))); };
  constexpr float kEdge = 1e-5F;
  const int end_y = last(std::max({a.y(), b.y(), c.y()}), height);
  const int end_x = last(std::max({a.x(), b.x(), c.x()}), width);
  for (int y = first(std::min({a.y(), b.y(), c.y()})); y <= end_y; ++y) {
    for (int x = first(std::min({a.x(), b.x(), c.x()})); x <= end_x; ++x) {
      const Eigen::Vector2f p = Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - a;
      const float at_b = (p.x() * ac.y() - ac.x() * p.y()) / doubled_area;
      const float at_c = (ab.x() * p.y() - p.x() * ab.y()) / doubled_area;
      if (at_b >= -kEdge && at_c >= -kEdge && at_b + at_c <= 1 + kEdge) {
        at(x, y, Eigen::Vector3f(1 - at_b - at_c, at_b, at_c));
      }
    }
  }
}

}  // namespace facet::mesh
