#include "simulation/placed_actor.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "facet/error.hpp"
#include "simulation/random.hpp"
#include "simulation/recorded_curves.hpp"

namespace facet::simulation {
namespace {

using Eigen::Isometry3f;
using Eigen::Vector3f;

Eigen::Matrix3f turn(const HeadMotion& motion) {
  return (Eigen::AngleAxisf(motion.yaw_rad, Vector3f::UnitY()) *
          Eigen::AngleAxisf(motion.pitch_rad, Vector3f::UnitX()) *
          Eigen::AngleAxisf(motion.roll_rad, Vector3f::UnitZ()))
      .toRotationMatrix();
}

/// Normals of an eyeball whose cornea is rounder than the rest, as its mirror images show, though the ball is
/// drawn as one sphere. from_centre_mm [3][vertex_count]; axis: unit, where the eye looks.
Eigen::Matrix3Xf cornea_normals(const Eigen::Matrix3Xf& from_centre_mm, const Vector3f& axis) {
  constexpr float kCornea_mm = 7.8F;  // its radius of curvature
  constexpr float kEdge_mm = 6.0F;    // of the cornea, from the axis
  Eigen::Matrix3Xf normals = from_centre_mm.colwise().normalized();
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const Vector3f sideways = from_centre_mm.col(v) - from_centre_mm.col(v).dot(axis) * axis;
    const float off_mm = sideways.norm();
    if (from_centre_mm.col(v).dot(axis) > 0 && off_mm > 0 && off_mm < kEdge_mm) {
      const float sine = std::min(off_mm / kCornea_mm, 0.9F);
      const Vector3f bent = sine / off_mm * sideways + std::sqrt(1 - sine * sine) * axis;
      const float rim = smooth_step(kEdge_mm, kEdge_mm - 0.8F, off_mm);
      normals.col(v) = (normals.col(v) + rim * (bent - normals.col(v))).normalized();
    }
  }
  return normals;
}

/// Throws Error(UnreadableInput) where curves move what the model has no shape for.
void check_names(const face::FaceModel& model, const RecordedCurves& curves) {
  constexpr float kMoves = 0.1F;
  std::vector<std::string> lacking;
  for (std::size_t k = 0; k < curves.largest().size(); ++k) {
    const std::string name = mesh::arkit_name(k);
    if (curves.largest()[k] > kMoves &&
        std::find(model.expression_names.begin(), model.expression_names.end(), name) ==
            model.expression_names.end()) {
      lacking.push_back(name);
    }
  }
  if (!lacking.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{} moves {}, for which the face model '{}' has no expression; leave it out, or "
                            "take another model",
                            curves.source(), fmt::join(lacking, ", "), model.name));
  }
}

}  // namespace

PlacedActor::PlacedActor(const face::FaceModel& model, const ActorTraits& traits,
                         const PerformanceConfig& performance)
    : actor_(model, traits), performance_(performance) {
  if (performance.curves) {
    check_names(model, *performance.curves);
  }
  const Anatomy& face = actor_.anatomy();
  middle_mm_ = 0.5F * (face.forehead + face.chin);
  pivot_mm_ = Vector3f(0, face.chin.y() + 25, face.nasion.z() - 95);
}

void PlacedActor::put(const Eigen::Matrix3f& axes, const Eigen::Vector3f& middle_mm, float head_motion) {
  axes_ = axes;
  resting_pivot_mm_ = middle_mm + axes * (pivot_mm_ - middle_mm_);
  head_motion_ = head_motion;
}

void PlacedActor::turn_once(float yaw_rad, double duration_s) {
  turn_rad_ = yaw_rad;
  turn_duration_s_ = std::max(duration_s, 1e-3);
}

std::vector<float> PlacedActor::expression(double time_s) const {
  return performance_.expression(time_s, actor_.expression_names());
}

HeadMotion PlacedActor::head_motion(double time_s) const {
  HeadMotion motion = performance_.head(time_s);
  motion.yaw_rad *= head_motion_;
  motion.pitch_rad *= head_motion_;
  motion.roll_rad *= head_motion_;
  motion.shift_mm *= head_motion_;
  const double half_turn = std::sin(std::numbers::pi * std::clamp(time_s / turn_duration_s_, 0.0, 1.0));
  motion.yaw_rad += turn_rad_ * static_cast<float>(half_turn * half_turn);
  return motion;
}

Isometry3f PlacedActor::pose(const HeadMotion& motion) const {
  // The performance shifts the head along the axes of a camera that it looks at: x right, y down, z forward.
  const Eigen::Matrix3f place_from_camera_axes = axes_ * Vector3f(1, -1, -1).asDiagonal();
  Isometry3f pose = Isometry3f::Identity();
  pose.linear() = axes_ * turn(motion);
  pose.translation() =
      resting_pivot_mm_ + place_from_camera_axes * motion.shift_mm - pose.linear() * pivot_mm_;
  return pose;
}

Isometry3f PlacedActor::place_from_head(double time_s) const {
  return pose(head_motion(time_s));
}

void PlacedActor::build_scene(double time_s, Scene& scene) const {
  ActorShape shape;
  actor_.shape(expression(time_s), performance_.gaze(time_s), shape);
  const Isometry3f head = place_from_head(time_s);
  scene.clear();
  scene.add(head * shape.head_mm, head.linear() * shape.head_normals, shape.albedo, actor_.head_materials(),
            actor_.head_triangles(), actor_.openness());
  const auto add = [&](const mesh::Vertices& part_mm, const Surface& surface) {
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(part_mm, surface.triangles, normals);
    scene.add(part_mm, normals, surface.albedo, surface.materials, surface.triangles, {});
  };
  for (const Eyeball& eyeball : actor_.eyeballs()) {
    const Surface& surface = actor_.eyeball_surface();
    const mesh::Vertices turned_mm =
        (gaze_rotation(shape.gaze) * surface.vertices_mm).colwise() + eyeball.centre_mm;
    if (actor_.look().painted()) {
      add(head * turned_mm, surface);
      continue;
    }
    const Vector3f axis = head.linear() * gaze_rotation(shape.gaze) * Vector3f::UnitZ();
    const Eigen::Matrix3Xf normals =
        cornea_normals((head * turned_mm).colwise() - head * eyeball.centre_mm, axis);
    constexpr float kShaded = 0.8F;  // a white that does not outshine the skin
    scene.add(head * turned_mm, normals, kShaded * surface.albedo, surface.materials, surface.triangles, {});
  }
  add(head * actor_.upper_teeth().vertices_mm, actor_.upper_teeth());
  add(head * shape.lower_teeth_mm, actor_.lower_teeth());
  // The body follows the head's shift by a good half and turns little.
  HeadMotion motion = head_motion(time_s);
  motion.yaw_rad *= 0.2F;
  motion.pitch_rad = 0;
  motion.roll_rad = 0;
  motion.shift_mm *= 0.6F;
  const Isometry3f body = pose(motion);
  const Torso& torso = actor_.torso();
  mesh::Vertices torso_mm(3, torso.surface.vertices_mm.cols());
  for (Eigen::Index v = 0; v < torso_mm.cols(); ++v) {
    const Vector3f at = torso.surface.vertices_mm.col(v);
    const float hold = torso.hold[static_cast<std::size_t>(v)];
    torso_mm.col(v) = hold * (head * at) + (1 - hold) * (body * at);
  }
  add(torso_mm, torso.surface);
  if (actor_.glasses().vertices_mm.cols() > 0) {
    add(head * actor_.glasses().vertices_mm, actor_.glasses());
  }
}

TruthMesh PlacedActor::neutral() const {
  ActorShape shape;
  actor_.shape(std::vector<float>(actor_.expression_names().size(), 0.0F), {}, shape);
  return {shape.head_mm, shape.head_normals, actor_.head_albedo(), actor_.head_triangles()};
}

render::Strands PlacedActor::strands_of(const Scene& scene) const {
  return place_strands(actor_.hair(), scene.vertices_mm, scene.normals, actor_.head_triangles());
}

TruthMesh PlacedActor::head_of(const Scene& scene) const {
  const Eigen::Index count = actor_.head_albedo().cols();
  return {scene.vertices_mm.leftCols(count), scene.normals.leftCols(count), scene.albedo.leftCols(count),
          actor_.head_triangles()};
}

}  // namespace facet::simulation
