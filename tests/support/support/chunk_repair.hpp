#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace facet::test {

/// docs/face-model-format.md, "Checksum".
inline std::uint64_t chunk_checksum(const std::uint8_t* bytes, std::size_t size) {
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
T get_at(const std::vector<std::uint8_t>& file, std::size_t at) {
  T value;
  std::memcpy(&value, file.data() + at, sizeof value);
  return value;
}

template <typename T>
void put_at(std::vector<std::uint8_t>& file, std::size_t at, T value) {
  std::memcpy(file.data() + at, &value, sizeof value);
}

/// Makes length and checksums right, so that the fuzzer reaches what lies behind them.
inline void repair_chunks(std::vector<std::uint8_t>& file) {
  constexpr std::size_t kHeader = 32;
  constexpr std::size_t kEntry = 40;
  if (file.size() < kHeader) {
    return;
  }
  put_at<std::uint64_t>(file, 16, file.size());
  const std::size_t chunks = get_at<std::uint32_t>(file, 12);
  if (chunks > (file.size() - kHeader) / kEntry) {
    return;
  }
  for (std::size_t i = 0; i < chunks; ++i) {
    const std::size_t entry = kHeader + i * kEntry;
    const auto offset = get_at<std::uint64_t>(file, entry + 8);
    const auto stored = get_at<std::uint64_t>(file, entry + 16);
    if (offset <= file.size() && stored <= file.size() - offset) {
      put_at(file, entry + 32, chunk_checksum(file.data() + offset, stored));
    }
  }
  put_at(file, 24, chunk_checksum(file.data() + kHeader, chunks * kEntry));
}

}  // namespace facet::test
