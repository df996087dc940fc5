#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "facet/error.hpp"
#include "gpu/spirv.hpp"

/// Any words are either a module whose interface is read, or refused.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint32_t> words(size / sizeof(std::uint32_t));
  if (!words.empty()) {
    std::memcpy(words.data(), data, words.size() * sizeof(std::uint32_t));
  }
  try {
    facet::gpu::reflect(words);
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
