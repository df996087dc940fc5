#include "landmark/face_geometry.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace facet::landmark {
namespace {

constexpr int right_eye_outer = 33;
constexpr int left_eye_outer = 263;
constexpr float window_scale = 1.5F;  ///< the landmark net was trained on windows of 1.5 face sizes

}  // namespace

float wrapped(float angle_rad) {
  return std::remainder(angle_rad, 2 * std::numbers::pi_v<float>);
}

Region window_of(const Eigen::Matrix3Xf& points_px) {
  const Eigen::Vector2f eyes = (points_px.col(left_eye_outer) - points_px.col(right_eye_outer)).head<2>();
  Region window;
  window.rotation_rad = std::atan2(eyes.y(), eyes.x());
  const Eigen::Vector2f right = window.right();
  const Eigen::Vector2f down = window.down();
  Eigen::Array2f low = Eigen::Array2f::Constant(std::numeric_limits<float>::max());
  Eigen::Array2f high = -low;
  for (int i = 0; i < points_px.cols(); ++i) {
    const Eigen::Vector2f point = points_px.col(i).head<2>();
    const Eigen::Array2f turned(point.dot(right), point.dot(down));
    low = low.min(turned);
    high = high.max(turned);
  }
  const Eigen::Array2f middle = 0.5F * (low + high);
  window.centre_px = middle.x() * right + middle.y() * down;
  window.size_px = window_scale * (high - low).maxCoeff();
  return window;
}

bool usable(const Region& window) {
  // A window of a few pixels holds no face, and one of a million would overflow the arithmetic.
  return window.centre_px.allFinite() && std::isfinite(window.rotation_rad) && window.size_px > 4.0F &&
         window.size_px < 1e6F && window.centre_px.cwiseAbs().maxCoeff() < 1e6F;
}

void measure_shape(const CanonicalFace& canonical, FaceLandmarks& face) {
  constexpr float n = landmark_count;
  const Eigen::Vector3f mean = face.points_px.rowwise().mean();
  const Eigen::Vector3f canonical_mean = canonical.vertices_cm.rowwise().mean();
  Eigen::Matrix3f covariance = Eigen::Matrix3f::Zero();
  float canonical_variance = 0;
  float variance = 0;
  for (int i = 0; i < landmark_count; ++i) {
    const Eigen::Vector3f point = face.points_px.col(i) - mean;
    const Eigen::Vector3f source = canonical.vertices_cm.col(i) - canonical_mean;
    covariance += point * source.transpose();
    canonical_variance += source.squaredNorm();
    variance += point.squaredNorm();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3f> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3f signs = Eigen::Vector3f::Ones();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) {
    signs.z() = -1;
  }
  face.camera_from_canonical = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const float fitted = svd.singularValues().dot(signs);
  const float scale = fitted / canonical_variance;
  const Eigen::Vector3f eyes =
      canonical.vertices_cm.col(left_eye_outer) - canonical.vertices_cm.col(right_eye_outer);
  face.interocular_px = scale * eyes.norm();
  face.shape_error = std::sqrt(std::max(0.0F, variance - fitted * scale) / n) / face.interocular_px;
}

void measure_confidence(const CanonicalFace& canonical, const Frame& frame, FaceLandmarks& face) {
  // Full confidence up to 65 degrees from the line of sight, none beyond 100: the net guesses hidden points.
  constexpr float full = 0.42F;
  constexpr float none = -0.17F;
  constexpr float axis_depth_cm = 4.0F;  ///< of the head's axis behind the mean of the face's points
  const Eigen::Vector3f mean = canonical.vertices_cm.rowwise().mean();
  const Eigen::RowVector3f towards_camera = -face.camera_from_canonical.row(2);
  face.confidence.resize(landmark_count);
  for (int i = 0; i < landmark_count; ++i) {
    const Eigen::Vector3f from_axis(canonical.vertices_cm(0, i) - mean.x(), 0,
                                    canonical.vertices_cm(2, i) - mean.z() + axis_depth_cm);
    const float facing = towards_camera * from_axis.normalized();
    const Eigen::Vector2f point = face.points_px.col(i).head<2>();
    const bool inside = point.x() >= -0.5F && point.y() >= -0.5F &&
                        point.x() <= static_cast<float>(frame.width_px) - 0.5F &&
                        point.y() <= static_cast<float>(frame.height_px) - 0.5F;
    face.confidence[i] = inside ? std::clamp((facing - none) / (full - none), 0.0F, 1.0F) : 0.0F;
  }
}

void measure_contradiction(const Eigen::Matrix3Xf& others_px, FaceLandmarks& face) {
  constexpr float seen = 0.5F;
  float squares = 0;
  int count = 0;
  for (int i = 0; i < landmark_count; ++i) {
    if (face.confidence[i] > seen) {
      squares += (others_px.col(i) - face.points_px.col(i)).head<2>().squaredNorm();
      ++count;
    }
  }
  face.contradiction =
      std::sqrt(squares / static_cast<float>(std::max(count, 1))) / std::max(face.interocular_px, 1e-3F);
}

void measure_iris_confidence(FaceLandmarks& face) {
  struct Eye {
    int outer, inner, upper, lower;
  };
  // Height over width of the opening: 0.25 to 0.4 in an open eye.
  constexpr float shut = 0.1F;
  constexpr float open = 0.2F;
  constexpr std::array<Eye, 2> eyes = {{{33, 133, 159, 145}, {263, 362, 386, 374}}};
  for (std::size_t e = 0; e < eyes.size(); ++e) {
    const Eye& eye = eyes[e];
    const auto distance = [&](int a, int b) {
      return (face.points_px.col(a) - face.points_px.col(b)).head<2>().norm();
    };
    const float opening = distance(eye.upper, eye.lower) / std::max(distance(eye.outer, eye.inner), 1e-3F);
    face.iris_confidence[e] = std::clamp((opening - shut) / (open - shut), 0.0F, 1.0F) *
                              std::min(face.confidence[eye.outer], face.confidence[eye.inner]);
  }
}

}  // namespace facet::landmark
