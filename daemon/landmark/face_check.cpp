#include "landmark/face_check.hpp"

namespace facet::landmark {

FaceCheck::FaceCheck(std::span<const std::uint8_t> tflite, const std::string& name, float min_score)
    : detector_(tflite, name), min_score_(min_score), aside_("facet-detect", [this] { look(); }) {}

void FaceCheck::ask(const Frame& frame, const Region& place) {
  if (aside_.begun()) {
    aside_.wait();
  }
  frame_ = frame;
  place_ = place;
  pending_ = true;
  aside_.begin();
}

std::optional<Region> FaceCheck::answer() {
  pending_ = false;
  aside_.wait();
  return seen_;
}

/// On the helper's thread.
void FaceCheck::look() {
  seen_.reset();
  Region around = place_;
  around.size_px *= Detection::second_look_scale / Detection::face_window_scale;
  const auto faces = detector_.detect(frame_, around, min_score_);
  const auto nearest = nearest_to(place_.centre_px, faces);
  if (nearest != faces.end()) {
    seen_ = nearest->face_region();
  }
  frame_ = {};  // its buffer goes back to the camera
}

}  // namespace facet::landmark
