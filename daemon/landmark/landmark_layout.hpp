#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "landmark/canonical_face.hpp"

namespace facet::landmark {

/// Outer corner of the subject's right and left eye: their distance scales reprojection errors.
inline constexpr int kRightEyeOuterCorner = 33;
inline constexpr int kLeftEyeOuterCorner = 263;

/// Parts of the face mesh whose points are measured with a like reliability.
enum class LandmarkGroup : std::uint8_t {
  Skin,     ///< everything that is in no other group: interpolated by the net, strongly correlated
  Contour,  ///< the face oval: slides along the outline, and sits on the silhouette rather than on the skin
  Brow,
  Eye,
  Lips,
  Nose,
};
inline constexpr int kLandmarkGroupCount = 6;

/// Group of every landmark, [landmark_count].
const std::array<LandmarkGroup, landmark_count>& landmark_groups();

/// The face oval in order along the outline, clockwise in the image of an unmirrored frontal face; closed.
std::span<const int> contour_landmarks();

/// The landmarks that the landmark net looks at again, in the order of its outputs: the lips, and what
/// surrounds the subject's right and left eye up to the brow.
std::span<const int> lip_landmarks();
std::span<const int> right_eye_landmarks();
std::span<const int> left_eye_landmarks();
/// The first so many of an eye's are the edges of its lids.
inline constexpr std::size_t kLidLandmarks = 16;

}  // namespace facet::landmark
