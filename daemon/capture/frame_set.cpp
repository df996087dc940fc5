#include "capture/frame_set.hpp"

namespace facet::capture {

std::string missing_pictures(const FrameSet& set) {
  if (set.complete()) {
    return {};
  }
  std::string text = "no picture of camera";
  for (std::size_t i = 0; i < set.frames.size(); ++i) {
    if ((set.missing >> i & 1) != 0) {
      text += " " + set.camera_names->at(i);
    }
  }
  return text;
}

}  // namespace facet::capture
