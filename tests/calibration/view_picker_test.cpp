#include "calibration/view_picker.hpp"

#include <gtest/gtest.h>

namespace facet::calibration {
namespace {

using Verdict = ViewPicker::Verdict;

/// Twelve corners whose first lies at a place.
BoardView at(double x_px, double y_px) {
  BoardView view;
  for (int i = 0; i < 12; ++i) {
    view.ids.push_back(i);
    view.px.emplace_back(x_px + 20 * (i % 4), y_px + 20 * (i / 4));
  }
  return view;
}

BoardView nothing() {
  BoardView view;
  view.problem = "no marker of the board is seen";
  return view;
}

TEST(ViewPicker, KeepsWhatRestsAndLiesElsewhere) {
  ViewPicker picker({640, 640});
  EXPECT_EQ(picker.offer({nothing(), nothing()}), Verdict::NoBoard);
  EXPECT_EQ(picker.offer({at(100, 100), nothing()}), Verdict::Moving);
  EXPECT_EQ(picker.offer({at(100, 100), nothing()}), Verdict::Kept);
  EXPECT_EQ(picker.offer({at(100.5, 100), nothing()}), Verdict::SeenBefore);
  EXPECT_EQ(picker.offer({at(140, 100), nothing()}), Verdict::Moving);
  EXPECT_EQ(picker.offer({at(150, 100), nothing()}), Verdict::Moving);
  EXPECT_EQ(picker.offer({at(150, 101), nothing()}), Verdict::Kept);
  // Back where it was, but now another camera sees it, too.
  EXPECT_EQ(picker.offer({at(100, 100), nothing()}), Verdict::Moving);
  EXPECT_EQ(picker.offer({at(100, 100), nothing()}), Verdict::SeenBefore);
  EXPECT_EQ(picker.offer({at(100, 100), at(30, 300)}), Verdict::Kept);
  EXPECT_EQ(picker.kept(), 3U);
}

TEST(ViewPicker, TheFirstMomentTellsNotWhetherItRests) {
  ViewPicker picker({640});
  EXPECT_EQ(picker.offer({at(100, 100)}), Verdict::Moving);
  EXPECT_EQ(picker.offer({at(100, 100)}), Verdict::Kept);
}

}  // namespace
}  // namespace facet::calibration
