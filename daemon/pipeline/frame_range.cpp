#include "pipeline/frame_range.hpp"

#include <fmt/format.h>

#include <charconv>
#include <string_view>

#include "facet/error.hpp"

namespace facet::pipeline {

FrameRange parse_frame_range(const std::string& text) {
  if (text.empty()) {
    return {};
  }
  const auto fail = [&] {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' is no range of frames: write A:B, from frame A up to but not including B; either "
                    "may be left out",
                    text));
  };
  const std::size_t colon = text.find(':');
  if (colon == std::string::npos) {
    fail();
  }
  FrameRange range;
  const auto read = [&](std::string_view digits, std::uint64_t& value) {
    if (digits.empty()) {
      return;
    }
    const auto [stop, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (error != std::errc() || stop != digits.data() + digits.size()) {
      fail();
    }
  };
  read(std::string_view(text).substr(0, colon), range.first);
  read(std::string_view(text).substr(colon + 1), range.end);
  if (range.first >= range.end) {
    fail();
  }
  return range;
}

}  // namespace facet::pipeline
