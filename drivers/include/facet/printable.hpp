#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <utility>

namespace facet {

/// A letter of UTF-8 at the beginning of a text and its bytes; none where the bytes are no letter.
inline std::pair<char32_t, std::size_t> first_letter(std::string_view text) {
  const auto byte = [&](std::size_t at) {
    return at < text.size() ? static_cast<unsigned char>(text[at]) : 0U;
  };
  const unsigned lead = byte(0);
  const std::size_t bytes = lead < 0x80 ? 1 : lead < 0xC0 ? 0 : lead < 0xE0 ? 2 : lead < 0xF0 ? 3 : 4;
  char32_t letter = bytes == 1 ? lead : lead & (0x7FU >> bytes);
  for (std::size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xC0U) != 0x80) {
      return {0, 0};
    }
    letter = letter << 6U | (byte(i) & 0x3FU);
  }
  constexpr std::array<char32_t, 5> kLeast{0, 0, 0x80, 0x800, 0x10000};  // by bytes; less could be shorter
  const bool good = text.size() >= bytes && bytes > 0 && lead < 0xF8 && letter >= kLeast.at(bytes) &&
                    letter <= 0x10FFFF && (letter < 0xD800 || letter > 0xDFFF);
  return good ? std::pair(letter, bytes) : std::pair(char32_t{0}, std::size_t{0});
}

/// A text from outside as it may go to a terminal or into a log: what would steer the terminal, begin a line
/// or turn the order of the letters (control characters, the direction marks of Unicode) and bytes that are
/// no UTF-8 become \x1b and \u{202e}; all else stays, backslashes too. What is shown once stays the same when
/// it is shown again. most_bytes: what would make it longer is left out.
inline std::string printable(std::string_view text,
                             std::size_t most_bytes = std::numeric_limits<std::size_t>::max()) {
  const auto hidden = [](char32_t letter) {
    return letter < 0x20 || (letter >= 0x7F && letter <= 0x9F) || letter == 0x061C || letter == 0x200E ||
           letter == 0x200F || (letter >= 0x2028 && letter <= 0x202E) ||
           (letter >= 0x2066 && letter <= 0x2069) || letter == 0xFEFF;
  };
  const auto hex = [](char32_t number, int digits) {
    std::string out;
    for (int digit = digits - 1; digit >= 0; --digit) {
      out += "0123456789abcdef"[number >> static_cast<unsigned>(4 * digit) & 0xFU];
    }
    return out;
  };
  std::string shown;
  while (!text.empty()) {
    const auto [letter, bytes] = first_letter(text);
    const std::size_t taken = bytes > 0 ? bytes : 1;
    std::string next;
    if (bytes == 0 || (hidden(letter) && letter < 0x80)) {
      next = "\\x" + hex(static_cast<unsigned char>(text.front()), 2);
    } else if (hidden(letter)) {
      next = "\\u{" + hex(letter, 4) + "}";
    } else {
      next = text.substr(0, taken);
    }
    if (next.size() > most_bytes - shown.size()) {
      break;
    }
    shown += next;
    text.remove_prefix(taken);
  }
  return shown;
}

}  // namespace facet
