#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "landmark/landmark_layout.hpp"
#include "landmark/landmarker.hpp"
#include "render/renderer.hpp"

namespace facet::model {

/// How well the landmarks that the net finds on renders of a model agree with the model's own anchors.
struct LandmarkAgreement {
  std::string pose;  ///< "neutral", "jawOpen" ...
  /// Mean distance in the image plane, mm at the face's depth, per landmark::LandmarkGroup.
  std::array<float, landmark::kLandmarkGroupCount> mean_mm{};
  bool found = false;  ///< false: the net sees no face there
};

/// Called after every rendered picture.
using LandmarkProgress = std::function<void(int done, int total)>;

/// Finds where MediaPipe's 468 landmarks lie on a model: renders its mean face from several sides, runs the
/// landmark net on the pictures and casts a ray through every point. Points around the eyes and mouth can
/// only land on skin, upper lip landmarks on what the jaw does not carry, lower ones on what it does; the
/// inner lips are looked up with the mouth a little open. The mean face is taken to be symmetric. Throws
/// Error(NoFace) where the net finds no face in a picture.
std::vector<face::LandmarkAnchor> find_landmarks(const face::FaceModel& model,
                                                 landmark::Landmarker& landmarker,
                                                 const LandmarkProgress& progress);

/// Runs the net on renders of the model's expressions and compares with the anchors (model.landmarks).
std::vector<LandmarkAgreement> check_landmarks(const face::FaceModel& model, landmark::Landmarker& landmarker,
                                               const LandmarkProgress& progress);

/// Pictures of the mean face and some expressions with the anchors (green) and what the net finds (red).
render::Picture landmark_sheet(const face::FaceModel& model, landmark::Landmarker& landmarker, int tile_px);

}  // namespace facet::model
