// Any text is MakeHuman data that holds together, or an Error(UnreadableInput). The real files are large:
// here a mesh has 4 vertices and a list 2 targets.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "facet/error.hpp"
#include "model/makehuman_data.hpp"

namespace {

constexpr int kVertices = 4;
constexpr std::size_t kTargets = 2;

template <typename Reader>
void expect_whole_or_refused(const Reader& is_whole) {
  try {
    if (!is_whole()) {
      std::abort();
    }
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::UnreadableInput) {
      std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  expect_whole_or_refused([&] {
    const auto mesh = facet::model::parse_makehuman_mesh(text, "fuzz", kVertices);
    return mesh.vertices_dm.allFinite() && mesh.group.size() == static_cast<std::size_t>(mesh.quads.cols()) &&
           (mesh.quads.size() == 0 || (mesh.quads.minCoeff() >= 0 && mesh.quads.maxCoeff() < kVertices));
  });
  expect_whole_or_refused([&] {
    const auto rows = facet::model::parse_makehuman_target_list(text, "fuzz", kTargets);
    for (const auto& [name, row] : rows) {
      if (name.empty() || row >= kTargets) {
        return false;
      }
    }
    return !rows.empty();
  });
  return 0;
}
