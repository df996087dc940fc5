#include "picture_size.hpp"

#include <fmt/format.h>

#include <cstdio>

#include "facet/error.hpp"

namespace facet::tools {

PictureSize parse_picture_size(const std::string& option, const std::string& text) {
  PictureSize size;
  int read = 0;
  if (std::sscanf(text.c_str(), "%dx%d%n", &size.width_px, &size.height_px, &read) != 2 ||
      static_cast<std::size_t>(read) != text.size()) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} {}: give width and height in pixels, as in 1280x720", option, text));
  }
  return size;
}

}  // namespace facet::tools
