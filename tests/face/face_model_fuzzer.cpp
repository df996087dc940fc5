// Any bytes: read as a model that is whole, or refused with Error(UnreadableInput).
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "facet/error.hpp"

namespace {

/// docs/face-model-format.md, "Checksum".
std::uint64_t checksum(const std::uint8_t* bytes, std::size_t size) {
  std::uint64_t hash = 14695981039346656037ULL;
  for (std::size_t at = 0; at < size; at += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes + at, std::min<std::size_t>(8, size - at));
    hash = (hash ^ word) * 1099511628211ULL;
    hash ^= hash >> 32;
  }
  return hash;
}

template <typename T>
T get(const std::vector<std::uint8_t>& file, std::size_t at) {
  T value;
  std::memcpy(&value, file.data() + at, sizeof value);
  return value;
}

template <typename T>
void put(std::vector<std::uint8_t>& file, std::size_t at, T value) {
  std::memcpy(file.data() + at, &value, sizeof value);
}

/// Makes length and checksums right, so that the fuzzer reaches what lies behind them.
void repair(std::vector<std::uint8_t>& file) {
  constexpr std::size_t kHeader = 32;
  constexpr std::size_t kEntry = 40;
  if (file.size() < kHeader) {
    return;
  }
  put<std::uint64_t>(file, 16, file.size());
  const std::size_t chunks = get<std::uint32_t>(file, 12);
  if (chunks > (file.size() - kHeader) / kEntry) {
    return;
  }
  for (std::size_t i = 0; i < chunks; ++i) {
    const std::size_t entry = kHeader + i * kEntry;
    const auto offset = get<std::uint64_t>(file, entry + 8);
    const auto stored = get<std::uint64_t>(file, entry + 16);
    if (offset <= file.size() && stored <= file.size() - offset) {
      put(file, entry + 32, checksum(file.data() + offset, stored));
    }
  }
  put(file, 24, checksum(file.data() + kHeader, chunks * kEntry));
}

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
  repair(file);
  read_model(file);
  return 0;
}
