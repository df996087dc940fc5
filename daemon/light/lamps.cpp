#include "light/lamps.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace facet::light {
namespace {

// Concentration of the bell by which directions are blended: half of its height at 8 degrees.
constexpr float kConcentration = 70;
// Cosine by which max(0, n . w) is rounded off at its edge.
constexpr float kEdge = 0.1F;
constexpr float kLeastMm = 100;  // from a near lamp to any skin

}  // namespace

const Eigen::Matrix3Xf& room_directions() {
  static const Eigen::Matrix3Xf directions = [] {
    Eigen::Matrix3Xf out(3, kRoomDirections);
    const double golden = std::numbers::pi * (1 + std::sqrt(5.0));
    for (int d = 0; d < kRoomDirections; ++d) {
      const double z = 1 - (2 * d + 1) / static_cast<double>(kRoomDirections);
      const double radius = std::sqrt(1 - z * z);
      const double angle = golden * (d + 0.5);
      out.col(d) = Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), z).cast<float>();
    }
    return out;
  }();
  return directions;
}

Eigen::MatrixXd turned_lamps(const Eigen::Matrix3f& to_from_from) {
  const Eigen::Matrix3Xf& directions = room_directions();
  const Eigen::MatrixXf cosines = directions.transpose() * (to_from_from * directions);
  Eigen::MatrixXd out = (kConcentration * (cosines.array() - 1)).exp().cast<double>();
  out.array().rowwise() /= out.colwise().sum().array().eval();
  return out;
}

Eigen::VectorXd turned(const Eigen::MatrixXd& to_from_from, const Eigen::VectorXd& lamps) {
  Eigen::VectorXd out(kLamps);
  out.head(kRoomDirections) = to_from_from * lamps.head(kRoomDirections);
  out.tail(kRoomDirections) = to_from_from * lamps.tail(kRoomDirections);
  return out;
}

float falloff(float along, float square) {
  const float distance = kNearMm * kNearMm - 2 * kNearMm * along + square;
  return kNearMm * kNearMm / std::max(distance, kLeastMm * kLeastMm);
}

Clamped clamped(float cosine) {
  const float t = std::clamp((cosine + kEdge) / (2 * kEdge), 0.0F, 1.0F);
  return {kEdge * t * t + std::max(0.0F, cosine - kEdge), t};
}

void descend(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right, double relative_ridge, int sweeps,
             Eigen::VectorXd& x) {
  const double ridge = relative_ridge * matrix.diagonal().mean();
  Eigen::VectorXd gradient = matrix * x - right;
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    for (Eigen::Index d = 0; d < x.size(); ++d) {
      const double diagonal = matrix(d, d) + ridge;
      if (!(diagonal > 0)) {
        continue;
      }
      const double next = std::max(0.0, x[d] - (gradient[d] + ridge * x[d]) / diagonal);
      const double step = next - x[d];
      if (step != 0) {
        gradient += step * matrix.col(d);
        x[d] = next;
      }
    }
  }
}

}  // namespace facet::light
