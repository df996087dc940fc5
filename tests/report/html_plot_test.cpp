// Plots as SVG: nothing that matters is thinned away.

#include "report/html_plot.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <regex>

namespace facet::report {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::ptrdiff_t count(const std::string& text, const std::string& part) {
  std::ptrdiff_t found = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++found;
  }
  return found;
}

/// The vertical positions of all points of a plot's lines, px: small is high.
std::vector<double> heights_of(const std::string& svg) {
  std::vector<double> heights;
  const std::regex lists("points=\"([^\"]*)\"");
  const std::regex points("(-?[0-9.]+),(-?[0-9.]+)");
  for (std::sregex_iterator list(svg.begin(), svg.end(), lists), end; list != end; ++list) {
    const std::string text = (*list)[1];
    for (std::sregex_iterator point(text.begin(), text.end(), points); point != end; ++point) {
      heights.push_back(std::stod((*point)[2]));
    }
  }
  return heights;
}

Plot plot_of(std::vector<float> values) {
  Plot plot;
  plot.title = "a plot";
  plot.unit = "mm";
  for (std::size_t i = 0; i < values.size(); ++i) {
    plot.at.push_back(static_cast<double>(i) / 30);
  }
  plot.lines.push_back({"line", std::move(values)});
  return plot;
}

TEST(HtmlPlot, ASpikeOfOneFrameInALongTakeIsSeen) {
  std::vector<float> values(36'000, 1.0F);
  values[20'001] = 10;
  const std::string svg = plot_svg(plot_of(values));
  const std::vector<double> heights = heights_of(svg);
  ASSERT_FALSE(heights.empty());
  EXPECT_LT(heights.size(), 2'100U) << "thinned to what a page can show";
  const double usual = heights.front();
  EXPECT_NEAR(*std::min_element(heights.begin(), heights.end()), 8, 0.1) << "10 is the axis' end";
  EXPECT_EQ(std::count_if(heights.begin(), heights.end(), [&](double y) { return y < usual - 1; }), 1);
  EXPECT_THAT(svg, HasSubstr("1 to 10"));
}

TEST(HtmlPlot, AGapIsNotBridged) {
  std::vector<float> values(300, 2.0F);
  EXPECT_EQ(count(plot_svg(plot_of(values)), "<polyline"), 1);
  values[150] = std::numeric_limits<float>::quiet_NaN();
  const std::string svg = plot_svg(plot_of(values));
  EXPECT_EQ(count(svg, "<polyline"), 2);
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
}

TEST(HtmlPlot, NothingToDrawIsSaid) {
  EXPECT_THAT(plot_svg(plot_of({})), HasSubstr("no values"));
  const std::string svg = plot_svg(plot_of(std::vector<float>(7, std::numeric_limits<float>::quiet_NaN())));
  EXPECT_THAT(svg, HasSubstr("no values"));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_EQ(count(plot_svg(plot_of({3})), "<circle"), 1) << "one frame is a dot";
}

TEST(HtmlPlot, StackedAreasAddUp) {
  Plot plot = plot_of({1, 1, 1});
  plot.lines.push_back({"more", {2, 2, 2}});
  plot.stacked = true;
  const std::string svg = plot_svg(plot);
  EXPECT_EQ(count(svg, "<polygon"), 2);
  const std::vector<double> heights = heights_of(svg);
  EXPECT_NEAR(*std::min_element(heights.begin(), heights.end()), 8, 0.1) << "1 + 2 is the axis' end";
  EXPECT_THAT(svg, HasSubstr("mean 2, 2 to 2")) << "the key tells of the line itself";
}

TEST(HtmlPlot, TextsAreWrittenOut) {
  Plot plot = plot_of({1, 2});
  plot.title = "<script>\"a\" & b</script>";
  EXPECT_THAT(plot_svg(plot), Not(HasSubstr("<script>")));
  EXPECT_EQ(html_text("<a href=\"x\">&"), "&lt;a href=&quot;x&quot;&gt;&amp;");
}

}  // namespace
}  // namespace facet::report
