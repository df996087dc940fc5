#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "facet/aside.hpp"
#include "facet/frame.hpp"
#include "landmark/face_detector.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// Looks with a detector of its own where the followed face of a frame is, while the frames go on: on the
/// helper thread `facet-detect`, of low priority. One question at a time. One thread.
class FaceCheck {
 public:
  /// min_score: as FaceDetector::detect. Throws Error(UnreadableInput) where the bytes are not the detector.
  FaceCheck(std::span<const std::uint8_t> tflite, const std::string& name, float min_score);

  /// Begins to look round `place`, the landmarks' window of the face in this frame, which is kept until then.
  /// Waits for a question that was dropped and is still looked at.
  void ask(const Frame& frame, const Region& place);

  /// Whether there is a question that was not answered or dropped.
  bool pending() const { return pending_; }

  /// Whether answer would return at once.
  bool ready() { return aside_.ready(); }

  /// Of the question that is pending: the window of the detected face nearest to the place; nothing where the
  /// detector sees none. Waits for it.
  std::optional<Region> answer();

  /// The place that was asked about.
  const Region& place() const { return place_; }

  /// What is pending is of no interest any more.
  void drop() { pending_ = false; }

 private:
  void look();

  FaceDetector detector_;
  float min_score_;
  Frame frame_;
  Region place_;
  std::optional<Region> seen_;
  bool pending_ = false;
  Aside aside_;
};

}  // namespace facet::landmark
