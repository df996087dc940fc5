#pragma once

#include <string>
#include <vector>

namespace facet::report {

/// One line of a plot. NaN: a gap.
struct PlotLine {
  std::string name;
  std::vector<float> values;  ///< [points]
};

/// What is drawn as one picture of lines over a common horizontal axis.
struct Plot {
  std::string title;
  std::string unit;        ///< of the values
  std::vector<double> at;  ///< [points] never descending
  std::string at_unit = "s";
  std::vector<PlotLine> lines;  ///< 10 at most have colours of their own
  bool stacked = false;         ///< areas upon each other instead of lines
  bool from_zero = true;        ///< the vertical axis begins at 0 unless values are below
  float most = 0;               ///< where the vertical axis ends at least
};

/// A plot as SVG to be put into a page with kPlotStyle: axes with round numbers, legend, mean and range of
/// every line. Columns that hold more points than one show the least and the greatest of them, so that
/// spikes are seen in plots of any length.
std::string plot_svg(const Plot& plot);

/// CSS that plots need; light and dark.
extern const char* const kPlotStyle;

/// A text with what HTML takes for markup written out.
std::string html_text(const std::string& text);

}  // namespace facet::report
