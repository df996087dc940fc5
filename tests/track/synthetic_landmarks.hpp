#pragma once

#include <Eigen/Core>
#include <random>

#include "face/face_model.hpp"
#include "landmark/landmarker.hpp"
#include "track/camera_pose.hpp"
#include "track/further_camera.hpp"
#include "track/landmark_model.hpp"

namespace facet::test {

/// A camera and a face before it, from which landmarks can be computed.
struct SyntheticView {
  double focal_px = 900;
  int width_px = 1280;
  int height_px = 720;
  track::Pose pose;
  Eigen::VectorXd identity;
  Eigen::VectorXd expression;

  Eigen::Vector2d centre_px() const { return {0.5 * (width_px - 1), 0.5 * (height_px - 1)}; }
};

/// A face near the middle of the image, half a metre away, turned by up to `turn_rad` and with random
/// expression.
inline SyntheticView random_view(const track::LandmarkModel& model, const Eigen::VectorXd& identity,
                                 std::mt19937& random, double turn_rad = 0.35) {
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  SyntheticView view;
  view.identity = identity;
  view.expression.resize(model.expression_count());
  for (double& weight : view.expression) {
    weight = std::max(0.0, unit(random)) * 0.8;
  }
  const Eigen::Vector3d turn(unit(random) * turn_rad, unit(random) * turn_rad, 0.5 * unit(random) * turn_rad);
  view.pose.rotation = track::rotation_from_vector(turn) * view.pose.rotation;
  view.pose.translation_mm = Eigen::Vector3d(30 * unit(random), 20 * unit(random), 520 + 60 * unit(random));
  return view;
}

inline Eigen::VectorXd random_identity(const track::LandmarkModel& model, std::mt19937& random) {
  std::normal_distribution<double> normal;
  Eigen::VectorXd identity(model.identity_count());
  for (double& weight : identity) {
    weight = normal(random);
  }
  return identity;
}

/// What a landmark net would measure of the view: projections, depth relative to the head, all seen.
/// noise_px: standard deviation of x and y. Landmarks without a place on the model are put at the centre.
inline landmark::FaceLandmarks synthetic_landmarks(const track::LandmarkModel& model,
                                                   const SyntheticView& view, double noise_px,
                                                   std::mt19937& random) {
  track::LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  const Eigen::VectorXd head_mm = basis.neutral_mm + basis.deltas_mm * view.expression;
  landmark::FaceLandmarks face;
  face.points_px.setZero(3, landmark::landmark_count);
  face.points_px.row(0).setConstant(static_cast<float>(view.centre_px().x()));
  face.points_px.row(1).setConstant(static_cast<float>(view.centre_px().y()));
  face.confidence.setOnes(landmark::landmark_count);
  face.presence = 1;
  std::normal_distribution<double> noise(0.0, 1.0);
  for (int l = 0; l < model.count(); ++l) {
    const Eigen::Vector3d camera_mm =
        view.pose.rotation * head_mm.segment<3>(3 * l) + view.pose.translation_mm;
    const Eigen::Vector2d px = view.focal_px * camera_mm.head<2>() / camera_mm.z() + view.centre_px();
    const double depth_px =
        view.focal_px * (camera_mm.z() - view.pose.translation_mm.z()) / view.pose.translation_mm.z();
    const Eigen::Vector3f measured =
        Eigen::Vector3d(px.x() + noise_px * noise(random), px.y() + noise_px * noise(random), depth_px)
            .cast<float>();
    const int landmark = model.landmarks()[static_cast<std::size_t>(l)];
    if (landmark < landmark::landmark_count) {
      face.points_px.col(landmark) = measured;
    } else {
      face.irises_px.conservativeResize(3, 2);
      face.irises_px.col(landmark - landmark::landmark_count) = measured;
      face.iris_confidence = {1, 1};
    }
  }
  face.interocular_px =
      static_cast<float>(view.focal_px * model.interocular_mm() / view.pose.translation_mm.z());
  return face;
}

/// A camera like that of `like`, turned by yaw_rad round a point half a metre before it.
inline track::FurtherCamera side_view(const SyntheticView& like, double yaw_rad) {
  constexpr double kDistanceMm = 520;
  track::FurtherCamera view;
  view.intrinsics = {.fx = static_cast<float>(like.focal_px),
                     .fy = static_cast<float>(like.focal_px),
                     .cx = static_cast<float>(like.centre_px().x()),
                     .cy = static_cast<float>(like.centre_px().y()),
                     .width_px = like.width_px,
                     .height_px = like.height_px};
  const Eigen::Vector3d middle_mm(0, 0, kDistanceMm);
  view.view_from_reference.linear() = track::rotation_from_vector({0, yaw_rad, 0});
  view.view_from_reference.translation() = middle_mm - view.view_from_reference.linear() * middle_mm;
  return view;
}

inline track::FitCamera camera_of(const track::FurtherCamera& view, const SyntheticView& reference) {
  return {.centre_px = {view.intrinsics.cx, view.intrinsics.cy},
          .focal_ratio = static_cast<double>(view.intrinsics.fx) / reference.focal_px,
          .view_from_reference = view.view_from_reference};
}

/// The same face as another camera sees it.
inline SyntheticView seen_by(const track::FurtherCamera& camera, const SyntheticView& view) {
  SyntheticView out = view;
  out.focal_px = camera.intrinsics.fx;
  out.pose.rotation = camera.view_from_reference.linear() * view.pose.rotation;
  out.pose.translation_mm = camera.view_from_reference * view.pose.translation_mm;
  return out;
}

}  // namespace facet::test
