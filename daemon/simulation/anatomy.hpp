#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "face/face_model.hpp"
#include "mesh/mesh.hpp"

namespace facet::simulation {

/// Where the parts of one resting face are: what wrinkles, colours and props are placed by. Head frame, mm.
/// Index 0 of a pair is the subject's right side, 1 the left.
struct Anatomy {
  std::array<Eigen::Vector3f, 2> eye_outer;
  std::array<Eigen::Vector3f, 2> eye_inner;
  std::array<Eigen::Vector3f, 2> lid_upper;
  std::array<Eigen::Vector3f, 2> lid_lower;
  std::array<Eigen::Vector3f, 2> brow;  ///< middle of the brow's upper edge
  std::array<Eigen::Vector3f, 2> mouth_corner;
  Eigen::Vector3f nasion;
  Eigen::Vector3f nose_tip;
  Eigen::Vector3f lip_upper;  ///< inner edge, middle
  Eigen::Vector3f lip_lower;
  Eigen::Vector3f chin;
  Eigen::Vector3f forehead;  ///< where MediaPipe's face ends above, about the hairline

  /// +1 for index 1 (the subject's left, positive x), -1 for index 0.
  static float side(std::size_t index) { return index == 1 ? 1.0F : -1.0F; }
};

/// Reads the parts off a model's landmark map. Throws Error(UnreadableInput) where the model lacks one.
Anatomy find_anatomy(const face::FaceModel& model, const mesh::Vertices& neutral_mm);

}  // namespace facet::simulation
