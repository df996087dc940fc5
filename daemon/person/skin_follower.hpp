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
/// the surface. The reference is the person and no earlier frame: nothing drifts. Used by one thread.
class SkinFollower {
 public:
  enum class Pace {
    EveryFrame,  ///< every picture is looked at, and the mesh moves at once
    Beside,      ///< now and then a picture is, on the helper thread `facet-skin`, of low priority, while the
                 ///< frames go on and wait for nothing; towards what it showed the mesh moves by and by
  };

  /// model  with the skin's albedo (FaceModel::skin). Throws Error(Usage) without one.
  explicit SkinFollower(const face::FaceModel& model, Pace pace = Pace::EveryFrame);
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
