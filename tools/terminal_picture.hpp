#pragma once

#include <cstdio>
#include <string>

#include "render/renderer.hpp"

namespace facet::tools {

/// A picture as text: two of its rows in each line of half blocks (U+2580), colours as escape sequences, in
/// 24 bits or as the nearest of the 256 that every terminal has. columns: of the terminal; the picture is
/// made smaller to fit, never larger.
std::string terminal_picture(const render::Picture& picture, int columns, bool true_colour);

/// Columns of the terminal behind a stream; 0: it is none.
int terminal_columns(std::FILE* stream);
/// Whether the environment says that the terminal has 24 bits of colour (COLORTERM).
bool terminal_has_true_colour();

}  // namespace facet::tools
