#pragma once

#include <memory>

#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "mesh/mesh.hpp"
#include "track/tracker.hpp"

namespace facet::person {

/// Follows a known person's skin: what a picture shows of the face, on the person's texture chart, against
/// the skin's albedo there tells how far every point of the skin lies from where the tracked mesh has it
/// (docs/person.md, "Following the skin"). The reference is the person and no earlier frame: nothing drifts.
/// One thread.
class SkinFollower {
 public:
  /// model       with the skin's albedo (FaceModel::skin). Throws Error(Usage) without one.
  /// look_every  frames from one look at a picture to the next (30 ms each); in between, and towards what it
  ///             shows, the mesh slides by and by. 1: it looks at every one and slides at once.
  explicit SkinFollower(const face::FaceModel& model, int look_every = 1);
  ~SkinFollower();

  /// Lets the tracked mesh slide along its own surface to where its skin is seen; what is not seen, or not
  /// known again, follows what is around it and else stays. Returns the share of the skin seen that was known
  /// again in the last look, 0 to 1; where that is too little nothing moves. A look allocates the head's part
  /// of the picture and some MB of charts, which OpenCV makes anew.
  ///
  /// picture      empty: it shows nothing, and the mesh slides as the last one said
  /// tracked      of this picture, with a mesh
  /// vertices_mm  [3][vertex_count] out: head frame
  double follow(const Frame& picture, const track::TrackResult& tracked, mesh::Vertices& vertices_mm);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::person
