#include "take/checksum.hpp"

#include <array>
#include <cstddef>
#include <cstring>

#ifdef __SSE4_2__
#include <nmmintrin.h>
#endif

namespace facet::take {
namespace {

constexpr std::uint32_t kReflectedPolynomial = 0x82F63B78;

constexpr std::array<std::uint32_t, 256> make_table() {
  std::array<std::uint32_t, 256> table{};
  for (std::uint32_t byte = 0; byte < table.size(); ++byte) {
    std::uint32_t remainder = byte;
    for (int bit = 0; bit < 8; ++bit) {
      remainder = (remainder >> 1U) ^ ((remainder & 1U) != 0 ? kReflectedPolynomial : 0);
    }
    table[byte] = remainder;
  }
  return table;
}

constexpr std::array<std::uint32_t, 256> kTable = make_table();

}  // namespace

std::uint32_t crc32c_by_table(std::span<const std::uint8_t> bytes) {
  std::uint32_t remainder = ~0U;
  for (const std::uint8_t byte : bytes) {
    remainder = (remainder >> 8U) ^ kTable.at((remainder ^ byte) & 0xFFU);
  }
  return ~remainder;
}

std::uint32_t crc32c(std::span<const std::uint8_t> bytes) {
#ifdef __SSE4_2__
  std::uint64_t remainder = 0xFFFFFFFF;
  std::size_t at = 0;
  for (; at + sizeof(std::uint64_t) <= bytes.size(); at += sizeof(std::uint64_t)) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data() + at, sizeof(word));
    remainder = _mm_crc32_u64(remainder, word);
  }
  auto rest = static_cast<std::uint32_t>(remainder);
  for (; at < bytes.size(); ++at) {
    rest = _mm_crc32_u8(rest, bytes[at]);
  }
  return ~rest;
#else
  return crc32c_by_table(bytes);
#endif
}

}  // namespace facet::take
