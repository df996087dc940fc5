// Shading on top of a booth's fine levels, with refinements that are scripted: whose it is, and what becomes
// of it when a device or a person goes.

#include "booth/booth_shading.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "facet/error.hpp"
#include "fit/fine_surface.hpp"
#include "scripted_stages.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using testing::Each;
using testing::FloatNear;
using testing::HasSubstr;

constexpr float kScripted_mm = 0.125F;  ///< every displacement of the scripted refiner
constexpr float kByDepth_mm = 0.1F;
constexpr float kBound_mm = 20;

/// What becomes of one camera's refinement; frames are told apart by their sequence.
class BoothShadingTest : public ::testing::Test {
 protected:
  BoothShadingTest() {
    for (int i = 0; i < 3; ++i) {
      capture::RigCamera& camera = rig_.cameras.emplace_back();
      camera.lens.width_px = 64;
      camera.lens.height_px = 48;
      camera.lens.fx_px = camera.lens.fy_px = 100;
      camera.lens.cx_px = 31.5;
      camera.lens.cy_px = 23.5;
      camera.colour = i > 0;
    }
    shading_.emplace(script_.stages().open_refiner, rig_, kBound_mm);
    begin(3000);
  }

  void begin(std::int32_t vertices) {
    surface_ = std::make_shared<const fit::TemplateMesh>(fit::make_template(*script_.model, vertices));
    fine_.emplace(script_.model->control, surface_, fit::FineOptions{});
    count_ = static_cast<std::size_t>(fine_->hierarchy()->finest().vertex_count);
    shading_->begin(*fine_->hierarchy(), *surface_, *script_.model);
  }

  static Frame picture(std::uint64_t sequence) {
    Frame frame;
    frame.sequence = sequence;
    frame.width_px = 64;
    frame.height_px = 48;
    frame.stride_bytes = 256;
    frame.pixels = std::make_shared<std::uint8_t[]>(256 * 48);
    return frame;
  }

  /// The two colour cameras' pictures have the sequences 2 n and 2 n + 1.
  std::string refine(std::uint64_t n) {
    const std::vector<Frame> pictures{picture(2 * n), picture(2 * n + 1)};
    return shading_->refine(pictures, surface_->neutral_mm, std::vector<float>(count_, kByDepth_mm),
                            added_mm_);
  }

  void expect_added(float added_mm) {
    EXPECT_EQ(added_mm_.size(), count_);
    EXPECT_THAT(added_mm_, Each(FloatNear(added_mm, 1e-6F)));
  }

  test::Script script_;
  capture::Rig rig_;
  std::shared_ptr<const fit::TemplateMesh> surface_;
  std::optional<fit::FineSurface> fine_;
  std::optional<booth::BoothShading> shading_;
  std::size_t count_ = 0;
  std::vector<float> added_mm_;
};

TEST_F(BoothShadingTest, AddsTheMeanOfTheColourCameras) {
  EXPECT_EQ(script_.opens, 2) << "one refinement a colour camera";
  EXPECT_EQ(refine(0), "");
  expect_added(kScripted_mm - kByDepth_mm);
}

TEST_F(BoothShadingTest, WithoutAPictureOfOneCameraTheOtherCounts) {
  const std::vector<float> by_depth(count_, kByDepth_mm);
  const std::vector<Frame> one{Frame(), picture(1)};
  EXPECT_EQ(shading_->refine(one, surface_->neutral_mm, by_depth, added_mm_), "");
  expect_added(kScripted_mm - kByDepth_mm);
  const std::vector<Frame> none(2);
  EXPECT_THAT(shading_->refine(none, surface_->neutral_mm, by_depth, added_mm_),
              HasSubstr("no colour camera"));
  expect_added(0);
  EXPECT_EQ(refine(1), "");
  EXPECT_THAT(script_.restarted_before, testing::UnorderedElementsAre(2U, 3U)) << "after a gap, anew";
}

TEST_F(BoothShadingTest, ALostGpuIsOpenedAgainAndMeanwhileAddsNothing) {
  // The second camera's device is lost with its first picture, then the first one's, too.
  script_.outcome_of = [](std::uint64_t sequence) {
    return sequence == 1 || sequence == 2 ? refine::RefineOutcome::DeviceLost
                                          : refine::RefineOutcome::Refined;
  };
  EXPECT_THAT(refine(0), HasSubstr("one of the colour cameras"));
  expect_added(kScripted_mm - kByDepth_mm);  // by the other
  EXPECT_THAT(refine(1), HasSubstr("one of the colour cameras"));
  expect_added(0);
  const auto end = std::chrono::steady_clock::now() + 30s;
  std::uint64_t n = 2;
  while (!refine(n).empty()) {
    ASSERT_LT(std::chrono::steady_clock::now(), end) << "neither comes back";
    std::this_thread::sleep_for(10ms);
    ++n;
  }
  expect_added(kScripted_mm - kByDepth_mm);
  EXPECT_EQ(script_.opens, 4);
  EXPECT_EQ(script_.subjects_set, 4) << "who comes back gets the person";
  EXPECT_EQ(script_.refiners_alive, 2) << "the lost ones are gone";
  EXPECT_FALSE(shading_->take_messages().empty()) << "and it is said";
}

TEST_F(BoothShadingTest, ASecondPersonTakesOver) {
  EXPECT_EQ(refine(0), "");
  const std::size_t first = count_;
  begin(12000);
  ASSERT_NE(count_, first) << "or the test shows nothing";
  EXPECT_EQ(refine(1), "");
  expect_added(kScripted_mm - kByDepth_mm);
  EXPECT_EQ(script_.subjects_set, 4);
}

TEST_F(BoothShadingTest, APersonWhoComesWhileTheGpuIsLostIsTheOneThatItGets) {
  script_.outcome_of = [](std::uint64_t sequence) {
    return sequence < 2 ? refine::RefineOutcome::DeviceLost : refine::RefineOutcome::Refined;
  };
  EXPECT_NE(refine(0), "");
  begin(12000);
  const auto end = std::chrono::steady_clock::now() + 30s;
  std::uint64_t n = 1;
  while (!refine(n).empty()) {
    ASSERT_LT(std::chrono::steady_clock::now(), end);
    ASSERT_EQ(added_mm_.size(), count_);
    std::this_thread::sleep_for(10ms);
    ++n;
  }
  expect_added(kScripted_mm - kByDepth_mm);
}

TEST_F(BoothShadingTest, BeyondTheBoundDepthAloneDecides) {
  const std::vector<Frame> pictures{picture(0), picture(1)};
  EXPECT_EQ(
      shading_->refine(pictures, surface_->neutral_mm, std::vector<float>(count_, 2 * kBound_mm), added_mm_),
      "");
  expect_added(kScripted_mm - kBound_mm);
}

}  // namespace
}  // namespace facet::pipeline
