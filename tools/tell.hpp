#pragma once

#include <fmt/format.h>

#include <cstdio>
#include <string_view>
#include <type_traits>

#include "facet/printable.hpp"

namespace facet::tools {

template <typename T>
auto shown(const T& value) {
  if constexpr (std::is_convertible_v<const T&, std::string_view>) {
    return printable(value);
  } else {
    static_assert(std::is_arithmetic_v<T>, "texts and numbers alone: others may hold texts from outside");
    return value;
  }
}

/// The one way to standard output and error, but for files that go there and JSON, which writes other letters
/// as \\u. The format may hold newlines and control sequences; of those in the arguments, which come from
/// files, takes and devices, none gets through (printable).
template <typename... Args>
void tell(std::FILE* stream, fmt::format_string<decltype(shown(std::declval<const Args&>()))...> format,
          const Args&... args) {
  fmt::print(stream, format, shown(args)...);
}

template <typename... Args>
void tell(fmt::format_string<decltype(shown(std::declval<const Args&>()))...> format, const Args&... args) {
  fmt::print(stdout, format, shown(args)...);
}

}  // namespace facet::tools
