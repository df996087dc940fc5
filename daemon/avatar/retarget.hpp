#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <string>
#include <vector>

#include "avatar/face_state.hpp"
#include "avatar/glb_document.hpp"

namespace facet::avatar {

/// A mesh of an avatar whose morph targets are ARKit's.
struct AvatarMesh {
  std::size_t mesh = 0;                ///< in the document
  std::vector<std::size_t> nodes;      ///< that show it
  std::vector<int> shapes;             ///< [target_count] index into mesh::kArkitNames; -1: another shape
  std::vector<float> resting_weights;  ///< [target_count]
};

/// What of an avatar a face can move.
struct Avatar {
  std::vector<AvatarMesh> meshes;        ///< those with one of ARKit's shapes at least
  std::vector<std::string> shape_names;  ///< of all morph targets of all meshes, as the file has them
  std::optional<std::size_t> head;       ///< node
  Eigen::Quaternionf world_from_parent = Eigen::Quaternionf::Identity();  ///< of the head's parent, at rest
  Eigen::Quaternionf head_at_rest = Eigen::Quaternionf::Identity();       ///< against its parent
  bool faces_backwards = false;  ///< VRM 0 looks along -z, all others along +z
};

/// Looks for ARKit's shapes in the meshes' extras.targetNames ("eyeBlinkLeft", "EyeBlinkLeft", "eyeBlink_L",
/// "face.eyeBlinkLeft"), and for the head: the node of that name (head_name), else VRM's head bone, else a
/// node whose name ends with "head". Throws Error(UnreadableInput) where the document is not sound,
/// Error(Usage) where there is no node head_name.
Avatar inspect_avatar(const GlbDocument& glb, const std::optional<std::string>& head_name);

/// The shapes among `wanted` (indices into mesh::kArkitNames) that no mesh of the avatar has.
std::vector<std::size_t> missing_shapes(const Avatar& avatar, const std::vector<std::size_t>& wanted);

/// Adds an animation to the document: weights of the avatar's meshes and, where `with_head`, the turns of its
/// head.
///
/// states   [frame_count] all tracked, at least one
/// times_s  [frame_count] rising, from 0
/// Throws Error(UnreadableInput) where the document is not sound.
void add_animation(GlbDocument& glb, const Avatar& avatar, const std::vector<FaceState>& states,
                   const std::vector<float>& times_s, bool with_head);

}  // namespace facet::avatar
