#include "terminal_picture.hpp"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <string_view>

namespace facet::tools {
namespace {

using Colour = std::array<int, 3>;

/// The mean colour of the part [x0, x1) x [y0, y1).
Colour mean_colour(const render::Picture& picture, int x0, int x1, int y0, int y1) {
  Colour sum{};
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      for (std::size_t c = 0; c < 3; ++c) {
        sum.at(c) +=
            picture.rgb[3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
                             static_cast<std::size_t>(x)) +
                        c];
      }
    }
  }
  const int count = std::max(1, (x1 - x0) * (y1 - y0));
  return {sum[0] / count, sum[1] / count, sum[2] / count};
}

/// "2;R;G;B", or "5;N" of the cube of 6 x 6 x 6 colours.
std::string code(const Colour& colour, bool true_colour) {
  if (true_colour) {
    return fmt::format("2;{};{};{}", colour[0], colour[1], colour[2]);
  }
  const auto step = [](int value) { return (value * 5 + 127) / 255; };
  return fmt::format("5;{}", 16 + 36 * step(colour[0]) + 6 * step(colour[1]) + step(colour[2]));
}

}  // namespace

std::string terminal_picture(const render::Picture& picture, int columns, bool true_colour) {
  const int width = std::min(columns, picture.width_px);
  if (width < 1 || picture.height_px < 1) {
    return "";
  }
  const int height = std::max(2, picture.height_px * width / picture.width_px / 2 * 2);
  const auto from_x = [&](int x) { return x * picture.width_px / width; };
  const auto from_y = [&](int y) { return y * picture.height_px / height; };
  std::string text;
  for (int y = 0; y < height; y += 2) {
    std::string before;
    for (int x = 0; x < width; ++x) {
      const int x0 = from_x(x);
      const int x1 = from_x(x + 1);
      const Colour upper = mean_colour(picture, x0, x1, from_y(y), from_y(y + 1));
      const Colour lower = mean_colour(picture, x0, x1, from_y(y + 1), from_y(y + 2));
      std::string colours =
          fmt::format("\x1b[38;{};48;{}m", code(upper, true_colour), code(lower, true_colour));
      if (colours != before) {
        text += colours;
        before = std::move(colours);
      }
      text += "\u2580";
    }
    text += "\x1b[0m\n";
  }
  return text;
}

int terminal_columns(std::FILE* stream) {
  winsize size{};
  const int fd = ::fileno(stream);
  return ::isatty(fd) != 0 && ::ioctl(fd, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
}

bool terminal_has_true_colour() {
  const char* given = std::getenv("COLORTERM");
  return given != nullptr && (std::string_view(given) == "truecolor" || std::string_view(given) == "24bit");
}

}  // namespace facet::tools
