// Any text is a mesh that holds together, or an Error(UnreadableInput).
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "facet/error.hpp"
#include "model/ict_model.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto mesh = facet::model::parse_obj({reinterpret_cast<const char*>(data), size}, "fuzz");
    if (!mesh.vertices.allFinite() || mesh.vertices.cols() == 0 ||
        (mesh.quads.size() > 0 &&
         (mesh.quads.minCoeff() < 0 || mesh.quads.maxCoeff() >= mesh.vertices.cols()))) {
      std::abort();
    }
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::UnreadableInput) {
      std::abort();
    }
  }
  return 0;
}
