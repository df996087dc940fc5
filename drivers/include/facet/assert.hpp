#pragma once

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <concepts>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <initializer_list>
#include <type_traits>

namespace facet {

/// A number of an assertion's state as text.
class AssertedValue {
 public:
  template <typename Number>
  requires std::is_arithmetic_v<Number> AssertedValue(
      Number number) {  // NOLINT(google-explicit-constructor): a list of numbers is given
    char* end = text_ + sizeof(text_) - 1;
    if constexpr (std::same_as<Number, bool>) {
      std::memcpy(text_, number ? "true" : "false", number ? 5 : 6);
    } else {
      *std::to_chars(text_, end, number).ptr = '\0';
    }
  }
  const char* text() const { return text_; }

 private:
  char text_[32] = {};
};

/// Says in one line on standard error (the journal takes it as critical) what did not hold, where and with
/// which numbers, and aborts. Takes no memory and no lock, so that it may be called anywhere.
[[noreturn]] [[gnu::cold]] [[gnu::noinline]] inline void assertion_failed(
    const char* condition, const char* names, const char* file, int line, const char* function,
    std::initializer_list<AssertedValue> values) {
  char message[1024];
  std::size_t length = 0;
  const auto add = [&](auto... parts) {
    const int wanted = std::snprintf(message + length, sizeof(message) - 1 - length, parts...);
    length += std::min(sizeof(message) - 2 - length, static_cast<std::size_t>(std::max(wanted, 0)));
  };
  // What systemd's journal takes a line for that begins so is told in sd-daemon(3).
  add("%sfacet: fault: %s does not hold in %s (%s:%d)", std::getenv("JOURNAL_STREAM") != nullptr ? "<2>" : "",
      condition, function, file, line);
  if (values.size() > 0) {
    add("; %s =", names);
    for (const AssertedValue& value : values) {
      add("%s%s", &value == values.begin() ? " " : ", ", value.text());
    }
  }
  message[length++] = '\n';
  [[maybe_unused]] const ssize_t ignored = ::write(STDERR_FILENO, message, length);
  std::abort();
}

}  // namespace facet

/// What holds whatever cameras, files, peers and users do; where it does not, the fault is Facet's own, and
/// going on would make wrong data. On in every build. Behind the condition stand the numbers that tell the
/// state: FACET_ASSERT(read <= written, read, written). Not for input (Error), and not per element of an
/// array in a hot loop.
#define FACET_ASSERT(condition, ...)                                                                    \
  (static_cast<bool>(condition) ? static_cast<void>(0)                                                  \
                                : ::facet::assertion_failed(#condition, "" #__VA_ARGS__, __FILE_NAME__, \
                                                            __LINE__, __func__, {__VA_ARGS__}))
