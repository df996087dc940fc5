#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <string>

#include "landmark/canonical_face.hpp"
#include "landmark/face_picture.hpp"
#include "landmark/network.hpp"

namespace facet::landmark {

/// MediaPipe's face mesh net [KAGG19]: 468 points in a window of 192 x 192 pixels.
class LandmarkNet {
 public:
  /// Throws Error(UnreadableInput) where the bytes are not this net.
  LandmarkNet(std::span<const std::uint8_t> tflite, const std::string& name);

  /// Finds the landmarks in a window that holds one face upright.
  ///
  /// points_px  [3][468] out: x, y in image pixels; z in the same scale, away from the camera, 0 near the
  ///            middle of the head
  /// returns    probability that the window holds a face, 0 to 1
  float find(const FacePicture& picture, Eigen::Matrix3Xf& points_px);

 private:
  Network network_;
};

}  // namespace facet::landmark
