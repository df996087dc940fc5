#include "simulation/lens_rays.hpp"

#include <cmath>
#include <cstddef>
#include <limits>

#include "render/renderer.hpp"

namespace facet::simulation {

using Eigen::Vector2f;

LensRays::LensRays(const capture::Lens& lens) : columns_(lens.width_px + 2) {
  directions_.resize(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(lens.height_px + 2));
  render::for_each_row(lens.height_px + 2, [&](int row) {
    for (int column = 0; column < columns_; ++column) {
      const auto seen = lens.direction({column - 1.0, row - 1.0});
      constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();
      directions_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                  static_cast<std::size_t>(column)] =
          seen ? Vector2f(seen->head<2>().cast<float>()) : Vector2f(kNowhere, kNowhere);
    }
  });
}

Eigen::Vector3f LensRays::direction(int x, int y, const Vector2f& offset_px) const {
  const Vector2f at = Vector2f(static_cast<float>(x + 1), static_cast<float>(y + 1)) + offset_px;
  const Vector2f low(std::floor(at.x()), std::floor(at.y()));
  const Vector2f part = at - low;
  const auto width = static_cast<std::size_t>(columns_);
  const Vector2f* corner =
      &directions_[static_cast<std::size_t>(low.y()) * width + static_cast<std::size_t>(low.x())];
  // A pixel's own centre needs no neighbour, which may not be there.
  const Vector2f top = part.x() > 0 ? (1 - part.x()) * corner[0] + part.x() * corner[1] : corner[0];
  if (!(part.y() > 0)) {
    return top.homogeneous();
  }
  const Vector2f bottom =
      part.x() > 0 ? (1 - part.x()) * corner[width] + part.x() * corner[width + 1] : corner[width];
  return ((1 - part.y()) * top + part.y() * bottom).homogeneous();
}

}  // namespace facet::simulation
