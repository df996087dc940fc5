#include "mesh/mesh_frame.hpp"

namespace facet::mesh {

const char* to_string(TrackingState state) {
  switch (state) {
    case TrackingState::Searching:
      return "searching";
    case TrackingState::Acquiring:
      return "acquiring";
    case TrackingState::Tracking:
      return "tracking";
    case TrackingState::Lost:
      return "lost";
  }
  return "unknown";
}

}  // namespace facet::mesh
