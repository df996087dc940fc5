#pragma once

#include <Eigen/Geometry>
#include <memory>

#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "mesh/mesh.hpp"
#include "track/tracker.hpp"

namespace facet::person {

/// A tracked head as its skin shows it.
struct FollowedHead {
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();
  mesh::Vertices vertices_mm;  ///< [3][vertex_count] head frame: the tracked ones, slid along their surface
};

/// Follows a known person's skin: what a picture shows of the face, on the person's texture chart, against
/// the skin's albedo there tells how far every point of the skin lies from where the tracked mesh has it
/// (docs/person.md, "Following the skin"). The head's pose takes its share of that, the rest is a slide along
/// the surface. The reference is the person and no earlier frame: nothing drifts. One thread.
class SkinFollower {
 public:
  /// model       with the skin's albedo (FaceModel::skin). Throws Error(Usage) without one.
  /// look_every  frames from one look at a picture to the next; in between, and towards what it shows, the
  ///             mesh moves by and by. 1: it looks at every one and moves at once.
  explicit SkinFollower(const face::FaceModel& model, int look_every = 1);
  ~SkinFollower();

  /// Moves a tracked head to where its skin is seen; what is not seen, or tells nothing, follows what is
  /// around it and else stays. Returns the share of the skin seen that was known again in the last look, 0 to
  /// 1; where that is too little nothing moves. A look allocates the head's part of the picture and some MB
  /// of charts, which OpenCV makes anew.
  ///
  /// picture  empty: it shows nothing, and the head moves as the last one said
  /// tracked  of this picture, with a mesh. Of several views the pose stays as it is
  double follow(const Frame& picture, const track::TrackResult& tracked, FollowedHead& out);

  /// The head was away, or another one is tracked: the next picture is looked at.
  void forget();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::person
