// Any bytes: read as a person that is whole, or refused with Error(UnreadableInput).
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "person/person_file.hpp"
#include "support/chunk_repair.hpp"

namespace {

void read(const std::vector<std::uint8_t>& file) {
  try {
    const auto person = facet::person::parse_person(std::as_bytes(std::span(file)), "input");
    if (!person.neutral_mm.allFinite() || person.width_px < 1) {
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
  std::vector<std::uint8_t> file(data, data + size);
  read(file);
  facet::test::repair_chunks(file);
  read(file);
  return 0;
}
