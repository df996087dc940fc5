#include "stereo/stereo_matcher.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "facet/error.hpp"
#include "support/gpu.hpp"
#include "support/refused_threads.hpp"
#include "support/stereo_scene.hpp"

namespace facet::stereo {
namespace {

using facet::test::StereoScene;
using Surface = StereoScene::Surface;
using StereoMatcherTest = facet::test::GpuTest;

constexpr int kWidth = 256;
constexpr int kHeight = 160;

StereoScene scene_of(Surface surface) {
  StereoScene scene(kWidth, kHeight);
  scene.surface = surface;
  scene.stripe_mm = 5;  // 3.3 px
  return scene;
}

std::vector<StereoSlot> slots_of(const StereoScene& scene, int count) {
  std::vector<StereoSlot> slots;
  for (int slot = 0; slot < count; ++slot) {
    slots.push_back({scene.picture(0, slot), scene.picture(1, slot), StereoScene::has_pattern(slot), {}});
    if (scene.fringe_mm > 0) {
      slots.back().fringes = {StereoScene::shift_turns(slot), !StereoScene::has_pattern(slot)};
    }
  }
  return slots;
}

StereoOptions options_for(int slots) {
  StereoOptions options;
  options.depths = {660, 840};
  options.most_slots = slots;
  options.most_sigma_mm = 1;
  return options;
}

struct Figures {
  double median_mm = 0;
  double percentile95_mm = 0;
  double fill = 0;
  int invented = 0;
};

Figures judge(const StereoScene& scene, const capture::DepthMap& map, int slot) {
  const std::vector<double> truth = scene.depth_mm(map.lens, slot);
  std::vector<double> errors;
  Figures out;
  int surface = 0;
  constexpr int border = 12;  // what the right picture does not reach
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const auto at = static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x);
      const double depth = static_cast<double>(map.depth_mm[at]);
      if (!(truth[at] > 0)) {
        out.invented += depth > 0 ? 1 : 0;
      } else if (x >= border && x < kWidth - border && y >= border && y < kHeight - border) {
        ++surface;
        if (depth > 0) {
          errors.push_back(std::abs(depth - truth[at]));
        }
      }
    }
  }
  std::ranges::sort(errors);
  out.fill = static_cast<double>(errors.size()) / surface;
  if (!errors.empty()) {
    out.median_mm = errors[errors.size() / 2];
    out.percentile95_mm = errors[errors.size() * 95 / 100];
  }
  return out;
}

// One px of disparity is 7.9 mm of depth here.
TEST_F(StereoMatcherTest, MovingWavesArePreciseInPatternAndBlankSlots) {
  const StereoScene scene = scene_of(Surface::Wave);
  const std::vector<StereoSlot> slots = slots_of(scene, 6);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(6));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  for (const int slot : {2, 3}) {
    SCOPED_TRACE(slot);
    const Figures figures = judge(scene, maps[static_cast<std::size_t>(slot)], slot);
    EXPECT_LT(figures.median_mm, 0.45);
    EXPECT_LT(figures.percentile95_mm, 1.6);
    EXPECT_GT(figures.fill, 0.95);
  }
  EXPECT_LE(matcher.dispatch_count(), 100U);
}

// What stereo finds under the same fringes is where phases begin.
TEST_F(StereoMatcherTest, FringesOnMovingWavesAreNearerThanStereo) {
  StereoScene scene = scene_of(Surface::Wave);
  scene.fringe_mm = 11;
  scene.speed_mm_per_slot = 0.5;
  std::vector<StereoSlot> slots = slots_of(scene, 6);
  StereoOptions options = options_for(6);
  options.depths = {720, 775};  // about a period: start values are right
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options);
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  std::vector<Figures> by_phase;
  for (const int slot : {2, 3}) {
    by_phase.push_back(judge(scene, maps[static_cast<std::size_t>(slot)], slot));
  }
  for (StereoSlot& slot : slots) {
    slot.fringes.reset();
  }
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  for (const int slot : {2, 3}) {
    SCOPED_TRACE(slot);
    const Figures& phases = by_phase[static_cast<std::size_t>(slot - 2)];
    const Figures stereo = judge(scene, maps[static_cast<std::size_t>(slot)], slot);
    EXPECT_LT(phases.median_mm, 0.6 * stereo.median_mm);
    EXPECT_LT(phases.percentile95_mm, stereo.percentile95_mm);
    EXPECT_GT(phases.fill, stereo.fill - 0.05);
  }
}

// A run may end where too few fringes tell a slot's period; the next one has more.
TEST_F(StereoMatcherTest, StartValuesThatFringesDidNotTellAreNotKept) {
  StereoScene scene = scene_of(Surface::Wave);
  scene.fringe_mm = 11;
  scene.speed_mm_per_slot = 0.5;
  std::vector<StereoSlot> slots = slots_of(scene, 6);
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    slots[slot].number = slot;
  }
  StereoOptions options = options_for(6);
  options.depths = {720, 775};
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options);
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(std::span(slots).first(2), maps), StereoOutcome::Done) << matcher.failure();
  EXPECT_EQ(judge(scene, maps[1], 1).fill, 0);
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  EXPECT_GT(judge(scene, maps[1], 1).fill, 0.7);
}

// One picture less, and one of another size: the others still tell.
TEST_F(StereoMatcherTest, FringesDoWithoutAPictureThatIsMissing) {
  StereoScene scene = scene_of(Surface::Plane);
  scene.fringe_mm = 11;
  std::vector<StereoSlot> slots = slots_of(scene, 6);
  slots[1].left = {};
  slots[5].right.width_px /= 2;
  StereoOptions options = options_for(6);
  options.depths = {720, 775};
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options);
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  const Figures figures = judge(scene, maps[2], 2);
  EXPECT_GT(figures.fill, 0.7);
  EXPECT_LT(figures.median_mm, 0.3);
}

// Nothing tells then which period is the right one.
TEST_F(StereoMatcherTest, FringesOfTooFewSlotsGiveNoDepth) {
  StereoScene scene = scene_of(Surface::Plane);
  scene.fringe_mm = 11;
  const std::vector<StereoSlot> slots = slots_of(scene, 2);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(2));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  EXPECT_EQ(judge(scene, maps[1], 1).fill, 0);
}

TEST_F(StereoMatcherTest, PlaneIsPreciseAndSigmaTellsTheError) {
  StereoScene scene = scene_of(Surface::Plane);
  const std::vector<StereoSlot> slots = slots_of(scene, 4);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(4));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done);
  const Figures figures = judge(scene, maps[1], 1);
  EXPECT_LT(figures.median_mm, 0.15);
  EXPECT_GT(figures.fill, 0.98);
  const std::vector<double> truth = scene.depth_mm(maps[1].lens, 1);
  double square = 0;
  int count = 0;
  for (int y = 20; y < kHeight - 20; ++y) {
    for (int x = 20; x < kWidth - 20; ++x) {
      const auto at = static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x);
      if (maps[1].depth_mm[at] > 0) {
        const double relative = (static_cast<double>(maps[1].depth_mm[at]) - truth[at]) /
                                static_cast<double>(maps[1].sigma_mm[at]);
        square += relative * relative;
        ++count;
        EXPECT_GT(maps[1].confidence[at], 0);
        EXPECT_LE(maps[1].confidence[at], 1);
      }
    }
  }
  const double ratio = std::sqrt(square / count);
  EXPECT_GT(ratio, 0.3);
  EXPECT_LT(ratio, 2);
}

TEST_F(StereoMatcherTest, AroundABallThereIsNothing) {
  const StereoScene scene = scene_of(Surface::Sphere);
  const std::vector<StereoSlot> slots = slots_of(scene, 4);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(4));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done);
  for (const int slot : {1, 2}) {
    const Figures figures = judge(scene, maps[static_cast<std::size_t>(slot)], slot);
    EXPECT_LT(figures.median_mm, 0.25);
    EXPECT_GT(figures.fill, 0.8);  // its rim is seen at a grazing angle
    EXPECT_LT(figures.invented, 60);
  }
}

TEST_F(StereoMatcherTest, WhatTheRightCameraDoesNotSeeIsAHole) {
  const StereoScene scene = scene_of(Surface::Step);
  const std::vector<StereoSlot> slots = slots_of(scene, 3);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(3));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done);
  // The far plate is to the left; its last 5 px (40 mm of depth) lie behind the near one for the right
  // camera.
  const std::vector<double> truth = scene.depth_mm(maps[1].lens, 1);
  int wrong = 0;
  int hidden = 0;
  int hidden_holes = 0;
  for (int y = 20; y < kHeight - 20; ++y) {
    int edge = 0;
    for (int x = 1; x < kWidth; ++x) {
      const auto at = static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x);
      edge = truth[at - 1] - truth[at] > 20 ? x : edge;
    }
    for (int x = edge - 4; x < edge; ++x) {
      const auto at = static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x);
      ++hidden;
      hidden_holes += maps[1].depth_mm[at] > 0 ? 0 : 1;
    }
    for (int x = edge - 30; x < edge + 30; ++x) {
      const auto at = static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x);
      const double depth = static_cast<double>(maps[1].depth_mm[at]);
      wrong += depth > 0 && std::abs(depth - truth[at]) > 5 ? 1 : 0;
    }
  }
  EXPECT_GT(hidden_holes, hidden / 2);
  EXPECT_LT(wrong, 0.04 * 60 * (kHeight - 40));
}

TEST_F(StereoMatcherTest, WithoutPatternFrameOrSynchronyThereIsNoSurface) {
  StereoScene scene = scene_of(Surface::Wave);
  std::vector<StereoSlot> dark = slots_of(scene, 3);
  for (int slot = 0; slot < 3; ++slot) {
    dark[static_cast<std::size_t>(slot)].left = scene.picture(0, 2);  // blank pictures that claim a pattern
    dark[static_cast<std::size_t>(slot)].right = scene.picture(1, 2);
    dark[static_cast<std::size_t>(slot)].has_pattern = true;
  }
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(4));
  std::vector<capture::DepthMap> maps;
  const auto depths = [](const capture::DepthMap& map) {
    return std::ranges::count_if(map.depth_mm, [](float d) { return d > 0; });
  };
  ASSERT_EQ(matcher.match(dark, maps), StereoOutcome::Done);
  for (const capture::DepthMap& map : maps) {
    EXPECT_LT(depths(map), kWidth * kHeight / 100);
  }
  // The right camera is one pattern behind.
  std::vector<StereoSlot> late = slots_of(scene, 4);
  for (int slot : {0, 1, 3}) {
    late[static_cast<std::size_t>(slot)].right = scene.picture(1, slot + 3);
  }
  ASSERT_EQ(matcher.match(late, maps), StereoOutcome::Done);
  for (const capture::DepthMap& map : maps) {
    EXPECT_LT(depths(map), kWidth * kHeight / 50);
  }
  std::vector<StereoSlot> missing = slots_of(scene, 2);
  missing[0].right = {};
  missing[1].left.corrupt = true;
  ASSERT_EQ(matcher.match(missing, maps), StereoOutcome::Done);
  EXPECT_EQ(depths(maps[0]) + depths(maps[1]), 0);
  // One missing picture is bridged by the slots beside it.
  std::vector<StereoSlot> bridged = slots_of(scene, 4);
  bridged[1].right = {};
  ASSERT_EQ(matcher.match(bridged, maps), StereoOutcome::Done);
  EXPECT_GT(depths(maps[1]), kWidth * kHeight * 7 / 10);
}

TEST_F(StereoMatcherTest, MaskedPixelsAndSaturatedOnesAreHoles) {
  const StereoScene scene = scene_of(Surface::Plane);
  std::vector<StereoSlot> slots = slots_of(scene, 2);
  std::vector<std::uint8_t> mask(static_cast<std::size_t>(kWidth) * kHeight, 0);
  for (std::size_t at = 0; at < mask.size(); ++at) {
    mask[at] = at % kWidth < kWidth / 2 ? 1 : 0;
  }
  for (StereoSlot& slot : slots) {
    slot.mask = mask;
    auto pixels = std::make_shared<std::vector<std::uint8_t>>(
        slot.left.pixels.get(), slot.left.pixels.get() + slot.left.stride_bytes * kHeight);
    for (int y = 60; y < 90; ++y) {
      std::fill_n(
          pixels->begin() + static_cast<std::ptrdiff_t>((static_cast<std::size_t>(y) * kWidth + 40) * 4),
          4 * 40, std::uint8_t{255});
    }
    slot.left.pixels = std::shared_ptr<const std::uint8_t[]>(pixels, pixels->data());
  }
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(2));
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done);
  int masked = 0;
  int saturated = 0;
  int kept = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool depth =
          maps[0].depth_mm[static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x)] > 0;
      masked += depth && x >= kWidth / 2 ? 1 : 0;
      const auto own =
          matcher.rectification().left_picture_px({static_cast<double>(x), static_cast<double>(y)});
      saturated += depth && own && own->x() > 46 && own->x() < 74 && own->y() > 66 && own->y() < 84 ? 1 : 0;
      kept += depth ? 1 : 0;
    }
  }
  EXPECT_EQ(masked, 0);
  EXPECT_EQ(saturated, 0);
  EXPECT_GT(kept, kWidth * kHeight / 4);
}

TEST_F(StereoMatcherTest, MapsAreMadeOfWhatIsWantedAndStartsOfKnownSlotsKept) {
  const StereoScene scene = scene_of(Surface::Wave);
  std::vector<StereoSlot> slots = slots_of(scene, 5);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(3));
  const std::span<const StereoSlot> all = slots;
  std::vector<capture::DepthMap> whole;
  ASSERT_EQ(matcher.match(all.first(3), whole), StereoOutcome::Done);
  const auto start_of = [&](std::size_t slot) {
    const std::size_t count = static_cast<std::size_t>(kWidth) * kHeight;
    const std::span<const float> line = matcher.start_px().subspan(slot * count, count);
    std::vector<float> out(line.begin(), line.end());
    std::ranges::replace_if(
        out, [](float d) { return std::isnan(d); }, 1e6F);
    return out;
  };
  for (std::size_t i = 0; i < slots.size(); ++i) {
    slots[i].wanted = i == 1;
    slots[i].number = 40 + i;
  }
  std::vector<capture::DepthMap> maps;
  ASSERT_EQ(matcher.match(all.first(3), maps), StereoOutcome::Done);
  ASSERT_EQ(maps.size(), 3U);
  EXPECT_EQ(maps[1].depth_mm, whole[1].depth_mm);
  EXPECT_EQ(maps[1].sigma_mm, whole[1].sigma_mm);
  for (const std::size_t slot : {std::size_t{0}, std::size_t{2}}) {
    EXPECT_EQ(maps[slot].depth_mm, std::vector<float>(maps[slot].depth_mm.size(), 0.0F));
  }
  const std::vector<float> third = start_of(2);
  // The third slot is the first of this run: alone with those after it, it would find something else.
  ASSERT_EQ(matcher.match(all.last(3), maps), StereoOutcome::Done);
  EXPECT_EQ(start_of(0), third);
  const std::vector<float> fourth = start_of(1);
  for (StereoSlot& slot : slots) {
    slot.number.reset();
  }
  ASSERT_EQ(matcher.match(all.last(3), maps), StereoOutcome::Done);
  EXPECT_NE(start_of(0), third);
  EXPECT_EQ(start_of(1), fourth);
}

// Grey is normalised in single precision on a device, in double on the host: values next to a rounding's edge
// differ by one.
TEST_F(StereoMatcherTest, StartValuesOfDeviceAndHostAgree) {
  const StereoScene scene = scene_of(Surface::Sphere);
  const std::vector<StereoSlot> slots = slots_of(scene, 4);
  std::array<std::vector<float>, 2> found;
  for (const bool device : {false, true}) {
    StereoOptions options = options_for(4);
    options.start.place = device ? StartPlace::Device : StartPlace::Host;
    StereoMatcher matcher(context(), scene.rig, {0, 1}, options);
    std::vector<capture::DepthMap> maps;
    ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
    found.at(device ? 1 : 0).assign(matcher.start_px().begin(), matcher.start_px().end());
  }
  std::size_t known = 0;
  std::size_t alone = 0;
  std::size_t apart = 0;
  for (std::size_t i = 0; i < found[0].size(); ++i) {
    const bool either = !std::isnan(found[0][i]) || !std::isnan(found[1][i]);
    const bool both = !std::isnan(found[0][i]) && !std::isnan(found[1][i]);
    known += either ? 1 : 0;
    alone += either && !both ? 1 : 0;
    apart += both && std::abs(found[0][i] - found[1][i]) > 0.02F ? 1 : 0;
  }
  EXPECT_GT(known, found[0].size() / 8);
  EXPECT_LT(alone, known / 500);
  EXPECT_LT(apart, known / 100);
}

TEST_F(StereoMatcherTest, DevicesRefuseStartValuesThatTheyCannotFind) {
  const StereoScene scene = scene_of(Surface::Plane);
  StereoOptions options = options_for(1);
  options.start.place = StartPlace::Device;
  options.start.method = StartMethod::ScanLines;
  EXPECT_THROW(StereoMatcher(context(), scene.rig, {0, 1}, options), Error);
  options.start.place = StartPlace::Best;
  EXPECT_NO_THROW(StereoMatcher(context(), scene.rig, {0, 1}, options));
}

TEST_F(StereoMatcherTest, ALostDeviceIsAnOutcome) {
  const StereoScene scene = scene_of(Surface::Plane);
  const std::vector<StereoSlot> slots = slots_of(scene, 1);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(1));
  context().simulate_loss();
  std::vector<capture::DepthMap> maps;
  EXPECT_EQ(matcher.match(slots, maps), StereoOutcome::DeviceLost);
  EXPECT_FALSE(matcher.failure().empty());
  EXPECT_EQ(std::ranges::count_if(maps[0].depth_mm, [](float d) { return d > 0; }), 0);
}

TEST(StereoThreads, AreBoundByProcessorsSlotsAndMemory) {
  constexpr std::size_t gib = std::size_t{1} << 30U;
  EXPECT_EQ(thread_count(4, 9, 0), 4);
  EXPECT_EQ(thread_count(64, 9, 0), 9);
  EXPECT_EQ(thread_count(64, 100, 0), 16);
  EXPECT_EQ(thread_count(0, 9, 0), 1) << "a machine that does not say";
  EXPECT_EQ(thread_count(64, 9, gib / 5), 5);
  EXPECT_EQ(thread_count(64, 9, gib / 5 + 1), 4);
  EXPECT_EQ(thread_count(64, 9, 3 * gib), 1) << "one finds them, whatever it takes";
}

TEST_F(StereoMatcherTest, WhatIsThrownAmidAMatchReachesTheCallerAndTheNextOneIsSound) {
  const StereoScene scene = scene_of(Surface::Plane);
  const std::vector<StereoSlot> slots = slots_of(scene, 4);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(4));
  std::vector<capture::DepthMap> expected;
  ASSERT_EQ(matcher.match(slots, expected), StereoOutcome::Done);
  std::vector<capture::DepthMap> maps;
  EXPECT_THROW(matcher.match(slots, maps, [] { throw Error(ErrorKind::Unavailable, "stopped"); }), Error);
  ASSERT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
  EXPECT_EQ(maps[1].depth_mm, expected[1].depth_mm);
}

#ifndef FACET_SANITIZED
TEST_F(StereoMatcherTest, WithoutThreadsOfItsOwnAMatchFindsTheSame) {
  const StereoScene scene = scene_of(Surface::Plane);
  const std::vector<StereoSlot> slots = slots_of(scene, 4);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(4));
  std::vector<capture::DepthMap> expected;
  ASSERT_EQ(matcher.match(slots, expected), StereoOutcome::Done);
  // The first that is made finds start values, where there are two processors; the next, maps.
  for (const int n : {1, 2}) {
    std::vector<capture::DepthMap> maps;
    facet::test::refuse_thread(n);
    EXPECT_EQ(matcher.match(slots, maps), StereoOutcome::Done) << matcher.failure();
    facet::test::refuse_thread(0);
    EXPECT_EQ(maps[1].depth_mm, expected[1].depth_mm);
  }
}
#endif

TEST_F(StereoMatcherTest, RefusesTooManySlots) {
  const StereoScene scene = scene_of(Surface::Plane);
  StereoMatcher matcher(context(), scene.rig, {0, 1}, options_for(1));
  std::vector<capture::DepthMap> maps;
  EXPECT_THROW(matcher.match(std::vector<StereoSlot>(2), maps), Error);
  EXPECT_THROW(matcher.match(std::vector<StereoSlot>{}, maps), Error);
}

}  // namespace
}  // namespace facet::stereo
