#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "landmark/canonical_face.hpp"
#include "landmark/face_picture.hpp"
#include "landmark/network.hpp"

namespace facet::landmark {

/// MediaPipe's face mesh net with attention [GAKRG20]: 468 points in a window of 192 x 192
/// pixels. Those of the lips and round the eyes come from a second look at the part of the features that the
/// first look's points enclose, and so do the irises. The graph names operators of its own for that; here the
/// graph is cut at them, and the crops are taken between its pieces.
class AttentionNet {
 public:
  /// Throws Error(UnreadableInput) where the bytes are not this net.
  AttentionNet(std::span<const std::uint8_t> tflite, const std::string& name);

  /// Finds the landmarks in a window that holds one face upright.
  ///
  /// points_px  [3][468] out: x, y in image pixels; z in the same scale, away from the camera, 0 near the
  ///            middle of the head
  /// irises_px  [3][2] out: centres of the subject's right and left iris; z 0
  /// returns    probability that the window holds a face, 0 to 1
  float find(const FacePicture& picture, Eigen::Matrix3Xf& points_px, Eigen::Matrix3Xf& irises_px);

 private:
  /// A part of the face that is looked at again.
  struct Part {
    Network head;
    std::span<const int> landmarks;  ///< in the order of the head's points; their extent gives the crop
    std::array<int, 2> corners;      ///< lie level in the crop
    Eigen::Index iris;               ///< column of irises_ for the head's second output; -1: it has none
  };

  AttentionNet(const TfliteModel& model, const std::string& name);
  void look_closer(Part& part);

  Network trunk_;
  std::vector<Part> parts_;
  Eigen::Matrix2Xf first_look_;  ///< [2][468] net pixels
  Eigen::Matrix3Xf refined_;     ///< [3][468] net pixels
  Eigen::Matrix3Xf irises_;      ///< [3][2] net pixels, z 0
};

}  // namespace facet::landmark
