#include "files/pfm.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <string_view>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::files {
namespace {

static_assert(std::endian::native == std::endian::little, "values are written in memory order");

constexpr int kMostSide_px = 32768;

[[noreturn]] void refuse(const std::string& source, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: not a portable float map: {}", source, why));
}

std::size_t row_bytes(int width_px) {
  return static_cast<std::size_t>(width_px) * sizeof(float);
}

template <typename Number>
bool read_number(std::string_view word, Number& number) {
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), number);
  return error == std::errc() && end == word.data() + word.size();
}

}  // namespace

void write_pfm(const FloatImage& image, const std::filesystem::path& file) {
  if (image.width_px < 1 || image.height_px < 1 ||
      image.values.size() !=
          static_cast<std::size_t>(image.width_px) * static_cast<std::size_t>(image.height_px)) {
    throw Error(ErrorKind::Internal, fmt::format("{}: {} values are no image of {}x{} px", file.string(),
                                                 image.values.size(), image.width_px, image.height_px));
  }
  OutputFile output(file);
  output.write(fmt::format("Pf\n{} {}\n-1.0\n", image.width_px, image.height_px));
  for (int y = image.height_px - 1; y >= 0; --y) {
    const float* row = &image.values[static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width_px)];
    output.write(std::as_bytes(std::span(row, static_cast<std::size_t>(image.width_px))));
  }
  output.commit();
}

FloatImage parse_pfm(std::span<const std::byte> bytes, const std::string& source) {
  // Kind, width, height, scale, each followed by one blank; then the values.
  std::array<std::string_view, 4> words;
  std::size_t at = 0;
  for (std::string_view& word : words) {
    constexpr std::size_t kLongestWord = 32;
    const std::size_t begin = at;
    const auto blank = [&] {
      const char c = static_cast<char>(bytes[at]);
      return c == ' ' || c == '\n' || c == '\t' || c == '\r';
    };
    while (at < bytes.size() && at - begin <= kLongestWord && !blank()) {
      ++at;
    }
    if (at == bytes.size() || at - begin > kLongestWord) {
      refuse(source, "its header has no end");
    }
    word = {reinterpret_cast<const char*>(bytes.data()) + begin, at - begin};
    ++at;
  }
  if (words[0] != "Pf") {
    refuse(source, "it does not begin with 'Pf' (grey)");
  }
  FloatImage image;
  const auto side = [&](std::string_view word, int& side_px) {
    if (!read_number(word, side_px) || side_px < 1 || side_px > kMostSide_px) {
      refuse(source, fmt::format("'{}' is not a side of 1 to {} px", word, kMostSide_px));
    }
  };
  side(words[1], image.width_px);
  side(words[2], image.height_px);
  double scale = 0;
  if (!read_number(words[3], scale) || !(scale < 0) || !std::isfinite(scale)) {
    refuse(source, fmt::format("its scale '{}' is not negative (little-endian)", words[3]));
  }
  const std::size_t row = row_bytes(image.width_px);
  const std::size_t wanted = row * static_cast<std::size_t>(image.height_px);
  if (bytes.size() - at != wanted) {
    refuse(source, fmt::format("{} bytes of values instead of {}", bytes.size() - at, wanted));
  }
  image.values.resize(wanted / sizeof(float));
  for (int y = 0; y < image.height_px; ++y) {
    const auto below = static_cast<std::size_t>(image.height_px - 1 - y);
    std::memcpy(&image.values[static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width_px)],
                bytes.data() + at + below * row, row);
  }
  return image;
}

FloatImage read_pfm(const std::filesystem::path& file) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 30;  // of 16384x16384 px; depth maps have a tenth
  const std::string text = read_text(file, kMostBytes, "float map");
  return parse_pfm(std::as_bytes(std::span(text)), file.string());
}

}  // namespace facet::files
