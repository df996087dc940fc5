#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::face {

/// What does not change from frame to frame of a subject: the adaptive hierarchy for the pose and camera of
/// its first good frame [MD19 sec. 3], names, identity. The id is a hash of hierarchy, identity
/// and the count. 0.1 to 0.4 s; allocates. Throws Error(UnreadableInput) where the model's mesh can't be
/// subdivided.
///
/// first_good  in state Tracking: pose, camera and control vertices are read
/// identity    [identity_count]
/// count       of the tracker's identity estimates
/// person      whose shape the model is, where it is one's alone
std::shared_ptr<const mesh::Subject> build_subject(const FaceModel& model,
                                                   const mesh::HierarchyOptions& options,
                                                   const mesh::MeshFrame& first_good,
                                                   const std::vector<float>& identity, std::uint32_t count,
                                                   const std::string& person = {});

/// What the model knows of its person's skin at a subject's finest vertices; empty where it knows nothing.
struct KnownSkin {
  std::vector<float> relief_mm;  ///< [finest vertex_count] of the face at rest
  mesh::Vertices albedo;         ///< [3][finest vertex_count] linear RGB
};
KnownSkin known_skin(const FaceModel& model, const mesh::Hierarchy& hierarchy);

/// Projections of head-frame vertices, px; NaN where they are behind or at the camera.
mesh::TextureCoordinates project(const mesh::Vertices& vertices_mm, const Eigen::Isometry3f& camera_from_head,
                                 const CameraIntrinsics& camera);

/// 1 where a vertex of the quad mesh is turned towards the camera, 0 elsewhere. [vertex_count]
std::vector<std::uint8_t> facing_camera(const mesh::Quads& quads, const mesh::Vertices& vertices_mm,
                                        const Eigen::Isometry3f& camera_from_head);

}  // namespace facet::face
