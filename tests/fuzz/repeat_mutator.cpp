// What libFuzzer's own mutations do not come to by themselves: depth and length. One mutation in four repeats
// a piece of the input until it is as long as the format allows, half of these with what closes it behind.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <string>
#include <utility>

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t most);

namespace {

/// What closes a piece of text: "[{" gives "}]", words stay.
std::string closing(std::string piece) {
  for (char& letter : piece) {
    constexpr std::pair<char, char> kPairs[] = {{'[', ']'}, {'{', '}'}, {'(', ')'}, {'<', '>'}};
    for (const auto& [open, close] : kPairs) {
      letter = letter == open ? close : letter;
    }
  }
  std::reverse(piece.begin(), piece.end());
  return piece;
}

}  // namespace

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t most,
                                               unsigned seed) {
  std::minstd_rand random(seed);
  const auto below = [&](std::size_t count) {
    return std::uniform_int_distribution<std::size_t>(0, count - 1)(random);
  };
  if (size == 0 || size >= most || below(4) != 0) {
    return LLVMFuzzerMutate(data, size, most);
  }
  const std::size_t begin = below(size);
  const std::string piece(reinterpret_cast<const char*>(data) + begin,
                          1 + below(std::min<std::size_t>(16, size - begin)));
  const std::string close = below(2) == 0 ? closing(piece) : "";
  // Lengths of all orders of magnitude: long inputs take long.
  const std::size_t room = (most - size) >> below(20);
  const std::size_t copies = room / (piece.size() + close.size());
  std::string added;
  added.reserve(room);
  for (std::size_t i = 0; i < copies; ++i) {
    added += piece;
  }
  for (std::size_t i = 0; i < copies; ++i) {
    added += close;
  }
  std::copy_backward(data + begin, data + size, data + size + added.size());
  std::copy(added.begin(), added.end(), data + begin);
  return size + added.size();
}
