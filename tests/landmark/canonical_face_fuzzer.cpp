#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "facet/error.hpp"
#include "landmark/canonical_face.hpp"

/// Any bytes: an error, or a mesh whose triangles lie within its vertices.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto face = facet::landmark::parse_canonical_face({data, size}, "fuzz");
    for (const auto& triangle : face.triangles) {
      for (const int corner : triangle) {
        if (corner < 0 || corner >= face.vertices_cm.cols()) {
          std::abort();
        }
      }
    }
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
