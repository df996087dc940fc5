#include "report/trigger_diagram.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <string>

namespace facet::report {
namespace {

/// Pixels of a colour, in one row of the picture or in all.
int pixels_of(const render::Picture& picture, std::array<std::uint8_t, 3> colour, int only_row = -1) {
  int count = 0;
  for (int y = 0; y < picture.height_px; ++y) {
    for (int x = 0; x < picture.width_px && (only_row < 0 || y == only_row); ++x) {
      const auto at = static_cast<std::ptrdiff_t>(3 * (y * picture.width_px + x));
      count += std::equal(colour.begin(), colour.end(), picture.rgb.begin() + at) ? 1 : 0;
    }
  }
  return count;
}

constexpr std::array<std::uint8_t, 3> kCamera = {25, 95, 180};
constexpr std::array<std::uint8_t, 3> kBad = {200, 40, 40};

trigger::EdgeLog parse(const std::string& events) {
  return trigger::parse_edge_log("facet-edges 1\nline a camera 0\n" + events, "log");
}

TEST(TriggerDiagram, ShowsEdgesAndWhatWasDropped) {
  const render::Picture pulse = draw_trigger_diagram(
      parse("fired 0 0 0 1 1000 1000 1\nedge 0 1 0 1 1000 1000 1\nedge 0 0 0 1 9000 9000 1\n"), 1);
  const render::Picture dropped = draw_trigger_diagram(parse("dropped 0 0 0 3 1000 9000 0\n"), 1);
  EXPECT_EQ(pixels_of(pulse, kBad), 0);
  EXPECT_GT(pixels_of(dropped, kBad), 40);
  constexpr int kHigh = 56;  // the row where the line's level is drawn while it is active
  EXPECT_EQ(pixels_of(dropped, kCamera, kHigh), 0);
  EXPECT_GT(pixels_of(pulse, kCamera, kHigh), 800);
  EXPECT_LT(pixels_of(pulse, kCamera, kHigh), 960) << "the plot's width";
}

TEST(TriggerDiagram, OddLogsAreDrawn) {
  for (const char* events :
       {"edge 0 1 0 1 0 0 0\n", "seen 0 1 5 1 9 9 0\nedge 0 1 2 1 4000000000000000000 0 0\n",
        "fired 0 0 3 1 4000000000000000000 1 0\nfired 0 0 1 1 0 0 0\n",
        "missing 0 1 0 1 5 0 0\ndropped 0 0 0 200000000000000 5 5 0\n"}) {
    EXPECT_GT(draw_trigger_diagram(parse(events), 1000).height_px, 90) << events;
  }
}

}  // namespace
}  // namespace facet::report
