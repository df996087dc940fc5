#pragma once

#include "landmark/canonical_face.hpp"
#include "landmark/landmarker.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// The window that the landmark net expects round the face with these landmarks: turned so that the outer eye
/// corners lie level, 1.5 times the longer side of the points' bounds in that orientation.
///
/// points_px  [3][468]
Region window_of(const Eigen::Matrix3Xf& points_px);

/// Whether a window is worth looking at: finite, at least 4 px, and small enough for the arithmetic.
bool usable(const Region& window);

/// An angle brought to -pi to pi.
float wrapped(float angle_rad);

/// Fills in rotation, interocular distance and shape error: the similarity that carries the canonical face to
/// the landmarks with the least squares [Ume91 eq. 38-43], and what remains.
void measure_shape(const CanonicalFace& canonical, FaceLandmarks& face);

/// Fills in the confidence: each landmark's place round the head against the line of sight, and whether it is
/// in the image. The place, not the surface normal: a nostril points down, yet the net sees it well from the
/// front. Needs the rotation of measure_shape.
void measure_confidence(const CanonicalFace& canonical, const Frame& frame, FaceLandmarks& face);

/// Sets contradiction; needs confidence and interocular_px.
///
/// others_px  [3][468] the same landmarks by another net
void measure_contradiction(const Eigen::Matrix3Xf& others_px, FaceLandmarks& face);

/// Sets iris_confidence from how far the lids are open and the eye is seen; needs confidence.
void measure_iris_confidence(FaceLandmarks& face);

}  // namespace facet::landmark
