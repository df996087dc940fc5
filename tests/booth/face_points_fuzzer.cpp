#include <cstddef>
#include <cstdint>
#include <string_view>

#include "booth/face_points.hpp"
#include "facet/error.hpp"

/// Any text is face points with finite places, or an Error of kind Usage.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace booth = facet::booth;
  if (size > booth::kMaxFacePointsFileBytes) {
    return 0;
  }
  try {
    const booth::FacePoints points =
        booth::parse_face_points({reinterpret_cast<const char*>(data), size}, "fuzz.toml");
    for (const booth::FacePoints::Camera& camera : points.cameras) {
      if (!camera.face.points_px.allFinite() || camera.face.confidence.size() != 468) {
        __builtin_trap();
      }
    }
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::Usage) {
      __builtin_trap();
    }
  }
  return 0;
}
