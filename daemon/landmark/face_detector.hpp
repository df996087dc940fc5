#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "facet/frame.hpp"
#include "landmark/network.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// One face as the detector sees it, in image pixels.
struct Detection {
  static constexpr float face_window_scale = 1.5F;  ///< boxes in the landmark net's window
  static constexpr float second_look_scale = 2.5F;

  enum KeyPoint : std::uint8_t { RightEye, LeftEye, NoseTip, Mouth, RightEar, LeftEar, Count };

  float score = 0;                               ///< 0 to 1
  Eigen::Vector2f centre_px;                     ///< of the box
  float size_px = 0;                             ///< the box's longer side
  std::array<Eigen::Vector2f, Count> points_px;  ///< subject's right and left

  /// The window that the landmark net expects round this face: 1.5 boxes, turned so that the eyes lie level.
  Region face_region() const;
  /// The window to look at this face again: 2.5 boxes, turned likewise.
  Region second_look() const;
};

/// Of the faces the one whose box's centre is nearest to a place; the end where there are none.
std::span<const Detection>::iterator nearest_to(const Eigen::Vector2f& place_px,
                                                std::span<const Detection> faces);

/// MediaPipe's short-range face detector (BlazeFace [BKVRG19]): 896 anchors on 128 x 128
/// pixels. Finds faces from about a tenth of the window to all of it, upright within about 45 degrees.
class FaceDetector {
 public:
  /// Throws Error(UnreadableInput) where the bytes are not this net.
  FaceDetector(std::span<const std::uint8_t> tflite, const std::string& name);

  /// Faces in a window of the frame with a score of at least `min_score`, overlaps merged (score-weighted, as
  /// BlazeFace does), best first. Valid until the next call. Allocates nothing after the first calls.
  std::span<const Detection> detect(const Frame& frame, const Region& window, float min_score);

 private:
  Network network_;
  RegionSampler sampler_;
  std::vector<Eigen::Vector2f> anchors_;  ///< [896] centres, 0 to 1
  std::vector<Detection> candidates_;
  std::vector<Detection> merged_;
};

}  // namespace facet::landmark
