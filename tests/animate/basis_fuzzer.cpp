// Reads arbitrary bytes as a basis file, as they are and with their checksum mended. An Error is the right
// answer to nonsense; in what is accepted every part must lie inside the bytes.

#include <cstdint>
#include <cstdlib>
#include <span>
#include <vector>

#include "animate/basis_file.hpp"
#include "facet/error.hpp"

namespace {

void read(std::span<const std::byte> bytes) {
  using namespace facet;
  try {
    const animate::BasisSections parts = animate::basis_sections(bytes);
    const animate::BasisHeader& header = *parts.header;
    const auto* end = reinterpret_cast<const std::uint8_t*>(bytes.data() + bytes.size());
    if (parts.eye_of_vertex + header.control_vertex_count > end) {
      std::abort();
    }
  } catch (const Error&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet;
  const auto given = std::as_bytes(std::span(data, size));
  std::vector<std::byte> bytes(given.begin(), given.end());
  read(bytes);
  if (size >= sizeof(animate::BasisHeader)) {
    animate::seal_basis(bytes);
    read(bytes);
  }
  return 0;
}
