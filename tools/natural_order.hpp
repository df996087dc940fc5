#pragma once

#include <algorithm>
#include <cstddef>
#include <string_view>

namespace facet::tools {

/// Whether a name comes before another one as people count: "shot2" before "shot10"; else by bytes.
inline bool natural_before(std::string_view a, std::string_view b) {
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  const std::string_view whole_a = a;
  const std::string_view whole_b = b;
  while (!a.empty() && !b.empty()) {
    if (!is_digit(a.front()) || !is_digit(b.front())) {
      if (a.front() != b.front()) {
        return static_cast<unsigned char>(a.front()) < static_cast<unsigned char>(b.front());
      }
      a.remove_prefix(1);
      b.remove_prefix(1);
      continue;
    }
    const auto number = [&](std::string_view& text) {
      text.remove_prefix(std::min(text.find_first_not_of('0'), text.size()));
      const auto end = std::find_if_not(text.begin(), text.end(), is_digit);
      const std::string_view digits = text.substr(0, static_cast<std::size_t>(end - text.begin()));
      text.remove_prefix(digits.size());
      return digits;
    };
    const std::string_view digits_a = number(a);
    const std::string_view digits_b = number(b);
    if (digits_a.size() != digits_b.size()) {
      return digits_a.size() < digits_b.size();
    }
    if (digits_a != digits_b) {
      return digits_a < digits_b;
    }
  }
  if (a.empty() != b.empty()) {
    return a.empty();
  }
  return whole_a < whole_b;  // "01" and "1"
}

}  // namespace facet::tools
