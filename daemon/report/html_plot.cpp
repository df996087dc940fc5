#include "report/html_plot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "facet/printable.hpp"

namespace facet::report {
namespace {

constexpr double kWidth = 960;
constexpr double kHeight = 220;
constexpr double kLeft = 56;
constexpr double kTop = 8;
constexpr double kBottom = 26;
constexpr double kRight = 12;
constexpr int kColumns = 900;
constexpr int kColours = 10;

struct Axis {
  double least = 0;
  double most = 1;
  double step = 1;  ///< between ticks
};

/// Round numbers around what is there: steps of 1, 2 or 5 times a power of ten.
Axis round_axis(double least, double most, int ticks) {
  if (!(most > least)) {
    most = least + 1;
  }
  const double rough = (most - least) / ticks;
  const double power = std::pow(10, std::floor(std::log10(rough)));
  const double part = rough / power;
  Axis axis;
  axis.step = power * (part <= 1 ? 1 : part <= 2 ? 2 : part <= 5 ? 5 : 10);
  axis.least = axis.step * std::floor(least / axis.step + 1e-9);
  axis.most = axis.step * std::ceil(most / axis.step - 1e-9);
  return axis;
}

/// One of the kColumns strips, side by side, that a plot is cut into: the least and the greatest value of the
/// points in it.
struct Column {
  double at = 0;  ///< of the first of these points, as Plot::at
  float least = std::numeric_limits<float>::infinity();
  float most = -std::numeric_limits<float>::infinity();
};

/// The columns that hold values, from left to right: one list for each piece of the line between two gaps.
std::vector<std::vector<Column>> columns_of(const Plot& plot, const std::vector<float>& values) {
  std::vector<std::vector<Column>> runs;
  if (plot.at.empty()) {
    return runs;
  }
  const double first = plot.at.front();
  const double span = std::max(plot.at.back() - first, 1e-12);
  bool goes_on = false;
  int last_column = -1;
  for (std::size_t i = 0; i < std::min(values.size(), plot.at.size()); ++i) {
    if (!std::isfinite(values[i])) {
      goes_on = false;
      continue;
    }
    const int column = static_cast<int>((plot.at[i] - first) / span * kColumns);
    // A gap within a column can't be seen.
    if (!goes_on && column != last_column) {
      runs.emplace_back();
    }
    if (column != last_column) {
      runs.back().push_back({plot.at[i]});
    }
    goes_on = true;
    last_column = column;
    Column& now = runs.back().back();
    now.least = std::min(now.least, values[i]);
    now.most = std::max(now.most, values[i]);
  }
  return runs;
}

/// The lines that bound the areas of a stacked plot from above: line l has at each point the sum of the
/// values of lines 0 to l there.
std::vector<PlotLine> stacked(const Plot& plot) {
  std::vector<PlotLine> sums = plot.lines;
  for (std::size_t l = 1; l < sums.size(); ++l) {
    for (std::size_t i = 0; i < std::min(sums[l].values.size(), sums[l - 1].values.size()); ++i) {
      sums[l].values[i] += sums[l - 1].values[i];
    }
  }
  return sums;
}

std::string range_of(const std::vector<float>& values) {
  float least = std::numeric_limits<float>::infinity();
  float most = -least;
  double sum = 0;
  std::size_t count = 0;
  for (const float value : values) {
    if (std::isfinite(value)) {
      least = std::min(least, value);
      most = std::max(most, value);
      sum += static_cast<double>(value);
      ++count;
    }
  }
  return count == 0
             ? "no values"
             : fmt::format("mean {:.3g}, {:.3g} to {:.3g}", sum / static_cast<double>(count), least, most);
}

}  // namespace

const char* const kPlotStyle = R"(
.plot{display:block;width:100%;max-width:960px;height:auto;margin:.2em 0}
.plot text{font:11px system-ui,sans-serif;fill:var(--faint)}
.plot .grid{stroke:var(--rule);stroke-width:1}
.plot polyline{fill:none;stroke-width:1.4;stroke-linejoin:round}
.plot polygon{stroke:none;fill-opacity:.75}
.key{display:flex;flex-wrap:wrap;gap:.2em 1.4em;margin:0;padding:0;list-style:none;font-size:.86em;color:var(--faint)}
.key b{color:var(--ink);font-weight:600}
.key i{display:inline-block;width:1.1em;height:.5em;margin-right:.4em;border-radius:2px}
:root{--c0:#0072b2;--c1:#d55e00;--c2:#009e73;--c3:#b5588f;--c4:#b58900;--c5:#56a0d0;--c6:#6c6c6c;--c7:#7a4fbf;--c8:#8c5a2b;--c9:#1a9aa8}
)";

std::string html_text(const std::string& text) {
  std::string out;
  for (const char letter : printable(text)) {
    switch (letter) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += letter;
    }
  }
  return out;
}

std::string plot_svg(const Plot& plot) {
  const std::vector<PlotLine> lines = plot.stacked ? stacked(plot) : plot.lines;
  double least = plot.from_zero ? 0 : std::numeric_limits<double>::infinity();
  double most = plot.most > 0 ? static_cast<double>(plot.most) : -std::numeric_limits<double>::infinity();
  for (const PlotLine& line : lines) {
    for (const float value : line.values) {
      if (std::isfinite(value)) {
        least = std::min(least, static_cast<double>(value));
        most = std::max(most, static_cast<double>(value));
      }
    }
  }
  if (!std::isfinite(least) || !std::isfinite(most)) {
    least = 0;
    most = 1;
  }
  const Axis y_axis = round_axis(least, most, 5);
  const double first = plot.at.empty() ? 0 : plot.at.front();
  const double last = plot.at.empty() ? 1 : plot.at.back();
  const double span = std::max(last - first, 1e-12);
  const auto x_of = [&](double at) { return kLeft + (kWidth - kLeft - kRight) * (at - first) / span; };
  const auto y_of = [&](double value) {
    return kTop + (kHeight - kTop - kBottom) * (y_axis.most - value) / (y_axis.most - y_axis.least);
  };

  std::string svg = fmt::format(
      "<figure><figcaption><h3>{}</h3></figcaption>\n<svg class=\"plot\" viewBox=\"0 0 {} {}\" role=\"img\" "
      "aria-label=\"{}\">\n",
      html_text(plot.title), kWidth, kHeight, html_text(plot.title));
  for (int k = 0; y_axis.least + k * y_axis.step <= y_axis.most + 1e-9 * y_axis.step; ++k) {
    const double value = y_axis.least + k * y_axis.step;
    svg += fmt::format(
        "<line class=\"grid\" x1=\"{}\" x2=\"{}\" y1=\"{:.1f}\" y2=\"{:.1f}\"/><text x=\"{}\" y=\"{:.1f}\" "
        "text-anchor=\"end\">{:.6g}</text>\n",
        kLeft, kWidth - kRight, y_of(value), y_of(value), kLeft - 6, y_of(value) + 4,
        std::abs(value) < 1e-9 * y_axis.step ? 0 : value);
  }
  const Axis x_axis = round_axis(first, last, 8);
  for (double at = x_axis.least; at <= last; at += x_axis.step) {
    if (at >= first) {
      svg += fmt::format("<text x=\"{:.1f}\" y=\"{}\" text-anchor=\"middle\">{:.6g} {}</text>\n", x_of(at),
                         kHeight - 8, std::abs(at) < 1e-9 * x_axis.step ? 0 : at, html_text(plot.at_unit));
    }
  }
  // Stacked areas are drawn from the highest sum down, so that each shows what it adds.
  for (std::size_t drawn = 0; drawn < lines.size(); ++drawn) {
    const std::size_t l = plot.stacked ? lines.size() - 1 - drawn : drawn;
    for (const std::vector<Column>& run : columns_of(plot, lines[l].values)) {
      std::string points;
      for (const Column& column : run) {
        if (plot.stacked || column.least == column.most) {
          points += fmt::format("{:.1f},{:.1f} ", x_of(column.at), y_of(static_cast<double>(column.most)));
        } else {
          points +=
              fmt::format("{0:.1f},{1:.1f} {0:.1f},{2:.1f} ", x_of(column.at),
                          y_of(static_cast<double>(column.least)), y_of(static_cast<double>(column.most)));
        }
      }
      const std::size_t colour = l % kColours;
      if (plot.stacked) {
        svg += fmt::format("<polygon style=\"fill:var(--c{})\" points=\"{:.1f},{:.1f} {}{:.1f},{:.1f}\"/>\n",
                           colour, x_of(run.front().at), y_of(0), points, x_of(run.back().at), y_of(0));
      } else if (run.size() == 1 && run.front().least == run.front().most) {
        svg += fmt::format("<circle style=\"fill:var(--c{})\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"1.5\"/>\n",
                           colour, x_of(run.front().at), y_of(static_cast<double>(run.front().most)));
      } else {
        svg += fmt::format("<polyline style=\"stroke:var(--c{})\" points=\"{}\"/>\n", colour, points);
      }
    }
  }
  svg += "</svg>\n<ul class=\"key\">\n";
  for (std::size_t l = 0; l < plot.lines.size(); ++l) {
    svg += fmt::format("<li><i style=\"background:var(--c{})\"></i><b>{}</b> {}{}{}</li>\n", l % kColours,
                       html_text(plot.lines[l].name), range_of(plot.lines[l].values),
                       plot.unit.empty() ? "" : " ", html_text(plot.unit));
  }
  return svg + "</ul></figure>\n";
}

}  // namespace facet::report
