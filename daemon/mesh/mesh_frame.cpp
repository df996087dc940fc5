#include "mesh/mesh_frame.hpp"

#include <cstddef>
#include <span>

namespace facet::mesh {
namespace {

std::uint64_t fnv1a(std::uint64_t state, std::span<const std::byte> bytes) {
  for (const std::byte byte : bytes) {
    state = (state ^ static_cast<std::uint64_t>(byte)) * 0x100000001b3U;
  }
  return state;
}

}  // namespace

const char* to_string(Origin origin) {
  switch (origin) {
    case Origin::Live:
      return "live";
    case Origin::Take:
      return "take";
    case Origin::Pose:
      return "pose";
  }
  return "";
}

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

bool has_mesh(const MeshFrame& frame) {
  return frame.subject != nullptr && frame.subject->hierarchy != nullptr &&
         !frame.subject->hierarchy->levels.empty() && frame.control_vertices_mm.cols() > 0 &&
         frame.control_vertices_mm.cols() == frame.subject->hierarchy->control_vertex_count;
}

std::uint64_t subject_id(const Subject& subject, std::uint32_t count) {
  std::uint64_t id = fnv1a(subject.hierarchy->id, std::as_bytes(std::span(subject.identity)));
  id = fnv1a(id, std::as_bytes(std::span(subject.person)));
  id = fnv1a(id, std::as_bytes(std::span(subject.neutral_mm.data(),
                                         static_cast<std::size_t>(subject.neutral_mm.size()))));
  id = fnv1a(id, std::as_bytes(std::span(&count, 1)));
  return id != 0 ? id : 1;
}

}  // namespace facet::mesh
