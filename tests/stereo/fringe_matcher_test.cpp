#include "stereo/fringe_matcher.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "facet/error.hpp"
#include "support/stereo_scene.hpp"

namespace facet::stereo {
namespace {

using facet::test::StereoScene;

constexpr double kTurn = 2 * std::numbers::pi;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

FringeSlot fringes(int slots_away, double shift_turns) {
  return {slots_away, {shift_turns, false}};
}
FringeSlot blank(int slots_away) {
  return {slots_away, {0, true}};
}

/// How far the phase of fringes is missed at most, whatever it is; everything drifts by this much a slot.
double most_error_rad(const std::vector<FringeSlot>& slots, double phase_drift_rad, double light_drift) {
  const std::vector<std::complex<double>> weights = phase_weights(slots).of_slots;
  double most = weights.size() == slots.size() ? 0 : kTurn;
  for (int k = 0; k < 32 && !weights.empty(); ++k) {
    const double phase = kTurn * k / 32;
    std::complex<double> sum;
    for (std::size_t i = 0; i < slots.size(); ++i) {
      const auto t = static_cast<double>(slots[i].slots_away);
      const double wave = std::cos(phase + phase_drift_rad * t + kTurn * slots[i].fringes.shift_turns);
      const double amplitude = slots[i].fringes.blank ? 0 : 0.3 * (1 + light_drift * t);
      sum += weights[i] * (0.5 * (1 + light_drift * t) + amplitude * wave);
    }
    most = std::max(most, std::abs(std::arg(sum * std::polar(1.0, -phase))));
    EXPECT_NEAR(std::abs(sum), 0.3, 0.05);
  }
  return most;
}

TEST(PhaseWeights, TellTheMomentsPhaseOfWhatDrifts) {
  const std::vector<FringeSlot> at_blank{fringes(-2, 0), fringes(-1, 0.25), blank(0), fringes(1, 0.5),
                                         fringes(2, 0.75)};
  const std::vector<FringeSlot> at_first{fringes(-3, 0),  fringes(-2, 0.25), blank(-1),
                                         fringes(0, 0.5), fringes(1, 0.75),  blank(2)};
  for (const std::vector<FringeSlot>& slots : {at_blank, at_first}) {
    EXPECT_LT(most_error_rad(slots, 0, 0), 0.005);
    EXPECT_LT(most_error_rad(slots, 0.05, 0), 0.04) << "of 0.1 that the phase goes in two slots";
    EXPECT_LT(most_error_rad(slots, 0, 0.01), 0.04);
  }
}

TEST(PhaseWeights, TheLastSlotsOfARecordingDoWithABlankOne) {
  const std::vector<FringeSlot> last{fringes(-2, 0.5), fringes(-1, 0.75), blank(0)};
  EXPECT_LT(most_error_rad(last, 0, 0), 0.02);
  const std::vector<FringeSlot> whole{fringes(-2, 0.5), fringes(-1, 0.75), blank(0), fringes(1, 0),
                                      fringes(2, 0.25)};
  EXPECT_GT(phase_weights(last).error_rad, 3 * phase_weights(whole).error_rad) << "motion counts for more";
}

TEST(PhaseWeights, AreNoneWhereNothingTellsThePhase) {
  EXPECT_TRUE(phase_weights({}).of_slots.empty());
  EXPECT_TRUE(phase_weights(std::vector{fringes(-1, 0), fringes(0, 0.25)}).of_slots.empty());
  EXPECT_TRUE(phase_weights(std::vector{fringes(-1, 0.5), fringes(0, 0.5), fringes(1, 0.5), fringes(2, 0.5)})
                  .of_slots.empty());
  EXPECT_TRUE(phase_weights(std::vector{blank(-1), blank(0), blank(1)}).of_slots.empty());
}

/// Waves that move under fringes, seen around slot 2.
struct FringeMatcherTest : testing::Test {
  static constexpr int kSlot = 2;

  FringeMatcherTest() {
    scene.fringe_mm = 11;
    for (int slot = 0; slot < 5; ++slot) {
      left.push_back(scene.picture(0, slot));
      right.push_back(scene.picture(1, slot));
    }
    for (int slot = 0; slot < 5; ++slot) {
      const auto at = static_cast<std::size_t>(slot);
      pictures.push_back({&left[at],
                          &right[at],
                          {slot - kSlot, {StereoScene::shift_turns(slot), !StereoScene::has_pattern(slot)}}});
    }
    for (const double depth : scene.depth_mm(rectification.left(), kSlot)) {
      truth_px.push_back(static_cast<float>(rectification.disparity_px(depth)));
    }
  }

  /// Of the pixels that both cameras see, the part that is no further than this from the truth.
  double right_part(const std::vector<float>& disparity_px, float within_px) const {
    constexpr std::size_t kBorder = 14;
    double count = 0;
    double good = 0;
    for (std::size_t y = kBorder; y + kBorder < 160; ++y) {
      for (std::size_t x = kBorder; x + kBorder < 256; ++x) {
        ++count;
        good += std::abs(disparity_px[y * 256 + x] - truth_px[y * 256 + x]) <= within_px ? 1 : 0;
      }
    }
    return good / count;
  }

  StereoScene scene{256, 160};
  Rectification rectification{scene.rig, {0, 1}, {660, 840}, 256, 160};
  std::vector<Eigen::Vector2f> left_sources = rectification.left_sources();
  std::vector<Eigen::Vector2f> right_sources = rectification.right_sources();
  std::vector<Frame> left, right;
  std::vector<FringePictures> pictures;
  std::vector<float> truth_px;
};

TEST_F(FringeMatcherTest, RefinesWhatStereoFound) {
  FringeMatcher matcher(left_sources, right_sources, 256, {});
  ASSERT_TRUE(matcher.look(pictures));
  std::mt19937 random(1);
  std::uniform_real_distribution<float> off(-0.3F, 0.3F);
  std::vector<float> disparity_px = truth_px;
  for (float& disparity : disparity_px) {
    disparity += off(random);
  }
  std::vector<float> sigma_px(disparity_px.size(), 0.3F);
  const float unknown = disparity_px[80 * 256 + 100];
  sigma_px[80 * 256 + 100] = 0;
  const double before = right_part(disparity_px, 0.05F);
  EXPECT_GT(matcher.refine(disparity_px, sigma_px), 30'000U);
  EXPECT_LT(before, 0.2);
  EXPECT_GT(right_part(disparity_px, 0.05F), 0.9);
  EXPECT_EQ(disparity_px[80 * 256 + 100], unknown) << "nothing was to be found there";
  std::vector<float> sigmas = sigma_px;
  std::ranges::sort(sigmas);
  EXPECT_LT(sigmas[sigmas.size() / 2], 0.05F);
}

// A period is 7.3 px here.
TEST_F(FringeMatcherTest, FollowsTheSurfaceWhereStartValuesAreAPeriodOff) {
  FringeMatcher matcher(left_sources, right_sources, 256, {});
  ASSERT_TRUE(matcher.look(pictures));
  std::vector<float> start_px = truth_px;
  for (std::size_t at = 0; at < start_px.size(); ++at) {
    const std::size_t x = at % 256;
    start_px[at] += x < 100 ? 7.3F : 0;
    start_px[at] = x % 40 < 3 && x < 100 ? kNan : start_px[at];
  }
  EXPECT_LT(right_part(start_px, 0.3F), 0.65);
  matcher.spread(start_px, std::vector<std::uint8_t>(start_px.size(), 1));
  EXPECT_GT(right_part(start_px, 0.3F), 0.97);
}

TEST_F(FringeMatcherTest, GoesNoFurtherThanIsLit) {
  FringeMatcher matcher(left_sources, right_sources, 256, {});
  ASSERT_TRUE(matcher.look(pictures));
  std::vector<float> start_px = truth_px;
  std::vector<std::uint8_t> lit(start_px.size(), 1);
  for (std::size_t at = 0; at < start_px.size(); ++at) {
    start_px[at] = at % 256 < 120 ? start_px[at] : kNan;
    lit[at] = at % 256 < 150 ? 1 : 0;
  }
  matcher.spread(start_px, lit);
  EXPECT_FALSE(std::isnan(start_px[80 * 256 + 148]));
  EXPECT_TRUE(std::isnan(start_px[80 * 256 + 151]));
}

// The last blank slot of a recording, of a face that moves: stereo's windows know it better.
TEST_F(FringeMatcherTest, PhasesFromOneSideAreForStartValuesAlone) {
  FringeMatcher matcher(left_sources, right_sources, 256, {});
  ASSERT_TRUE(matcher.look(std::span(pictures).first(3)));
  std::vector<float> disparity_px = truth_px;
  std::vector<float> sigma_px(disparity_px.size(), 0.3F);
  EXPECT_EQ(matcher.refine(disparity_px, sigma_px), 0U);
  matcher.spread(disparity_px, std::vector<std::uint8_t>(disparity_px.size(), 1));
  EXPECT_GT(right_part(disparity_px, 1), 0.9);
}

TEST_F(FringeMatcherTest, SaturatedPixelsAndTooFewSlotsTellNothing) {
  FringeMatcher matcher(left_sources, right_sources, 256, {});
  EXPECT_FALSE(matcher.look(std::span(pictures).first(2)));
  FringeOptions options;
  options.saturated = 0.01F;
  FringeMatcher blinded(left_sources, right_sources, 256, options);
  ASSERT_TRUE(blinded.look(pictures));
  std::vector<float> disparity_px = truth_px;
  std::vector<float> sigma_px(disparity_px.size(), 0.3F);
  EXPECT_EQ(blinded.refine(disparity_px, sigma_px), 0U);
  EXPECT_EQ(disparity_px, truth_px);
  options.noise = 0;
  EXPECT_THROW(FringeMatcher(left_sources, right_sources, 256, options), Error);
}

}  // namespace
}  // namespace facet::stereo
