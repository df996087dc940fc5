#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "face/face_model.hpp"
#include "simulation/actor.hpp"
#include "simulation/performance.hpp"
#include "simulation/shading.hpp"
#include "simulation/truth_mesh.hpp"

namespace facet::simulation {

/// The virtual actor performing in a place (a camera's frame, a booth's): poses of head and body, and all
/// that can be seen of it, at any time. Everything follows from seed, place and time. Any thread once placed.
class PlacedActor {
 public:
  /// Throws Error(UnreadableInput) where the model has no landmark map or lacks an expression that recorded
  /// curves move, Error(Usage) as Performance does.
  PlacedActor(const face::FaceModel& model, const ActorTraits& traits, const PerformanceConfig& performance);

  /// Where and how the head rests, and how much of the performance's head motion it makes.
  /// axes             turns head axes to the place's for a head that looks straight ahead
  /// middle_mm        the place's point where the face's middle rests
  void put(const Eigen::Matrix3f& axes, const Eigen::Vector3f& middle_mm, float head_motion = 1);
  /// The head also turns to the subject's left by so much and back, once in duration_s.
  void turn_once(float yaw_rad, double duration_s);

  const VirtualActor& actor() const { return actor_; }
  /// What the head turns about, at rest; in the place's frame.
  const Eigen::Vector3f& resting_pivot_mm() const { return resting_pivot_mm_; }
  std::vector<float> expression(double time_s) const;
  Eigen::Isometry3f place_from_head(double time_s) const;

  /// Everything that can be seen at a time, in the place's frame; the head comes first.
  void build_scene(double time_s, Scene& scene) const;
  /// The hairs of a scene made by build_scene.
  render::Strands strands_of(const Scene& scene) const;
  /// The head's surface of a scene made by build_scene, without eyeballs, teeth, neck and glasses.
  TruthMesh head_of(const Scene& scene) const;
  /// The same surface without any expression, head frame.
  TruthMesh neutral() const;

 private:
  Eigen::Isometry3f pose(const HeadMotion& motion) const;
  HeadMotion head_motion(double time_s) const;

  VirtualActor actor_;
  Performance performance_;
  Eigen::Vector3f middle_mm_;  ///< of the face, head frame
  Eigen::Vector3f pivot_mm_;   ///< head frame
  Eigen::Matrix3f axes_ = Eigen::Matrix3f::Identity();
  Eigen::Vector3f resting_pivot_mm_{0, 0, 0};
  float head_motion_ = 1;
  float turn_rad_ = 0;
  double turn_duration_s_ = 1;
};

}  // namespace facet::simulation
