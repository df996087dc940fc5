#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "facet/error.hpp"
#include "fuzz_spirv_shaders.hpp"
#include "gpu/spirv.hpp"

namespace {

/// One word of a real module to be replaced.
struct Damage {
  std::uint16_t position;
  std::uint16_t unused;
  std::uint32_t word;
};

/// The words that the input stands for: itself where its first byte is 0, otherwise a real module with words
/// replaced.
std::vector<std::uint32_t> words_of(const std::uint8_t* data, std::size_t size) {
  const facet::gpu::ShaderSet kernels = facet::shaders::fuzz_spirv::kernels();
  if (data[0] == 0) {
    std::vector<std::uint32_t> words((size - 1) / sizeof(std::uint32_t));
    if (!words.empty()) {
      std::memcpy(words.data(), data + 1, words.size() * sizeof(std::uint32_t));
    }
    return words;
  }
  const facet::gpu::Shader& kernel = kernels[data[0] % kernels.size()];
  std::vector<std::uint32_t> words(kernel.words.begin(), kernel.words.end());
  for (std::size_t at = 1; at + sizeof(Damage) <= size; at += sizeof(Damage)) {
    Damage damage{};
    std::memcpy(&damage, data + at, sizeof(damage));
    words[damage.position % words.size()] = damage.word;
  }
  return words;
}

}  // namespace

/// Any words are either a module whose interface is read, or refused.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) {
    return 0;
  }
  try {
    facet::gpu::reflect(words_of(data, size));
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
