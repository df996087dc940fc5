// A truth mesh of any bytes is read or refused, nothing else.

#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "facet/error.hpp"
#include "simulation/truth_mesh.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto mesh = facet::simulation::parse_truth_ply(std::as_bytes(std::span(data, size)), "fuzzed");
    if (!mesh.vertices_mm.allFinite() || !mesh.normals.allFinite() ||
        (mesh.triangles.size() > 0 && mesh.triangles.maxCoeff() >= mesh.vertices_mm.cols())) {
      std::abort();
    }
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
