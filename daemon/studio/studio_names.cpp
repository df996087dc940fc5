#include "studio/studio.hpp"

namespace facet::studio {

const char* to_string(Shown shown) {
  switch (shown) {
    case Shown::Pose:
      return "pose";
    case Shown::Take:
      return "take";
    case Shown::Keys:
      return "keys";
  }
  return "";
}

const char* to_string(StudioState state) {
  switch (state) {
    case StudioState::Closed:
      return "closed";
    case StudioState::Opening:
      return "opening";
    case StudioState::Ready:
      return "ready";
    case StudioState::Preparing:
      return "preparing";
    case StudioState::Playing:
      return "playing";
    case StudioState::Exporting:
      return "exporting";
  }
  return "";
}

}  // namespace facet::studio
