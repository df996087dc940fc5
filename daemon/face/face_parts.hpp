#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::face {

/// Parts of the face.
enum class FacePart : std::uint8_t { Forehead, Brows, Lids, Nose, Cheeks, Mouth, ChinAndJaw };
inline constexpr std::array<const char*, 7> kFacePartNames{"forehead", "brows", "lids",        "nose",
                                                           "cheeks",   "mouth", "chin_and_jaw"};

/// The part that each control vertex is of, by where it lies on the mean face seen from the front (head
/// frame, x and y), between the model's landmarks (numbers of MediaPipe's face mesh). The first that fits:
/// nose (between the root, the wings and the base), mouth (up to 7 mm around the lips), brows (4 mm around
/// them), lids (9 mm around the eyes), forehead (above the line of the brows), chin and jaw (below the
/// corners of the mouth), else cheeks. Of vertices beyond the face it says what they would be.
///
/// model     with landmarks
/// returns   [vertex_count]
std::vector<FacePart> control_parts(const FaceModel& model);

/// The part of each finest vertex: the one that most of what it depends on is of.
///
/// control_parts   [control vertex_count]
/// returns         [finest vertex_count]
std::vector<FacePart> finest_parts(const mesh::Hierarchy& hierarchy,
                                   const std::vector<FacePart>& control_parts);

/// How far what shades the skin there is its shape: 0 on the brows and up to 4 mm around them, whose hair is
/// darker than any fold, 1 from 10 mm on.
///
/// model     without landmarks: 1 everywhere
/// returns   [vertex_count]
std::vector<float> shading_trust(const FaceModel& model);

}  // namespace facet::face
