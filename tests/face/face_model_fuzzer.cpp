// Any bytes: read as a model that is whole, or refused with Error(UnreadableInput).
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "support/chunk_repair.hpp"

namespace {

void read_model(const std::vector<std::uint8_t>& file) {
  constexpr std::uint64_t kMaxCoreValues = 1 << 20;  // keeps each run small
  try {
    const auto model = facet::face::FaceModel::parse(std::as_bytes(std::span(file)), "input", kMaxCoreValues);
    if (!model.check().empty()) {
      std::abort();
    }
    model.contract_identity({});
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::UnreadableInput) {
      std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint8_t> file(data, data + size);
  read_model(file);
  facet::test::repair_chunks(file);
  read_model(file);
  return 0;
}
