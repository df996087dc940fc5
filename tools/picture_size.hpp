#pragma once

#include <string>

namespace facet::tools {

struct PictureSize {
  int width_px = 0;
  int height_px = 0;
};

/// Reads "1280x720". Throws Error(Usage) naming the option where the text is none.
PictureSize parse_picture_size(const std::string& option, const std::string& text);

}  // namespace facet::tools
