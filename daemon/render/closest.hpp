#pragma once

#include <Eigen/Core>

namespace facet::render {

/// Barycentric weights (second, third vertex) of the point of triangle a b c nearest to p.
Eigen::Vector2f closest_barycentric(const Eigen::Vector3f& a, const Eigen::Vector3f& b,
                                    const Eigen::Vector3f& c, const Eigen::Vector3f& p);

}  // namespace facet::render
