#include "scan/structured_light.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "facet/error.hpp"
#include "support/stereo_scene.hpp"

namespace facet::scan {
namespace {

using facet::test::StereoScene;
using ::testing::HasSubstr;
using Surface = StereoScene::Surface;

constexpr int kWidth = 240;
constexpr int kHeight = 160;
constexpr double kTurn = 2 * std::numbers::pi;
constexpr double kPeriods = 64;
constexpr float kSigma_rad = 0.01F;

StereoScene scene_of(Surface surface) {
  StereoScene scene(kWidth, kHeight);
  scene.surface = surface;
  return scene;
}

/// What a camera would decode: the projector's phases where it lights what the camera sees, exact but for
/// noise. rows: coded too
DecodedView view_of(const StereoScene& scene, std::size_t camera, bool rows = false, double noise_rad = 0) {
  const capture::Lens& lens = scene.rig.cameras[camera].lens;
  const capture::Lens& projector = scene.rig.projectors.front().lens;
  const Eigen::Isometry3d rig_from_camera = lens.camera_from_rig.inverse();
  std::mt19937 random(7 + static_cast<std::uint32_t>(camera));
  std::normal_distribution<double> normal;
  DecodedView view;
  view.width_px = lens.width_px;
  view.height_px = lens.height_px;
  const auto count = static_cast<std::size_t>(lens.width_px) * static_cast<std::size_t>(lens.height_px);
  for (PhaseField* field : {&view.columns, &view.rows}) {
    if (field == &view.columns || rows) {
      field->width_px = lens.width_px;
      field->height_px = lens.height_px;
      field->periods = kPeriods;
      field->start_rad = 0.4;
      field->phase_rad.assign(count, std::numeric_limits<float>::quiet_NaN());
      field->sigma_rad.assign(count, 0);
    }
  }
  for (int y = 0; y < lens.height_px; ++y) {
    for (int x = 0; x < lens.width_px; ++x) {
      const auto at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(lens.width_px) + static_cast<std::size_t>(x);
      const auto direction = lens.direction({static_cast<double>(x), static_cast<double>(y)});
      const auto point =
          direction ? scene.meet(rig_from_camera.translation(), rig_from_camera.linear() * *direction, 0)
                    : std::nullopt;
      const auto lit = point ? projector.project(*point) : std::nullopt;
      if (!lit || lit->x() < 0 || lit->x() > projector.width_px - 1) {
        continue;
      }
      const auto put = [&](PhaseField& field, double pixel, int length) {
        field.phase_rad[at] =
            static_cast<float>(0.4 + kTurn * kPeriods * (pixel + 0.5) / length + noise_rad * normal(random));
        field.sigma_rad[at] = kSigma_rad;
      };
      put(view.columns, lit->x(), projector.width_px);
      if (rows) {
        put(view.rows, lit->y(), projector.height_px);
      }
    }
  }
  return view;
}

StructuredLightOptions options_for() {
  StructuredLightOptions options;
  options.depths = {660, 840};
  options.most_sigma_mm = 2;
  return options;
}

struct Figures {
  std::size_t surface = 0;
  std::size_t depths = 0;
  std::size_t invented = 0;
  double worst_mm = 0;
  double rms_mm = 0;
  double relative = 0;
};

Figures judge(const StereoScene& scene, const capture::DepthMap& map) {
  const std::vector<double> truth = scene.depth_mm(map.lens, 0);
  Figures out;
  double relative = 0;
  double squares = 0;
  for (std::size_t at = 0; at < truth.size(); ++at) {
    const auto depth = static_cast<double>(map.depth_mm[at]);
    out.surface += truth[at] > 0 ? 1 : 0;
    if (!(depth > 0)) {
      EXPECT_EQ(map.sigma_mm[at], 0);
      EXPECT_EQ(map.confidence[at], 0);
      continue;
    }
    ++out.depths;
    if (!(truth[at] > 0)) {
      ++out.invented;
      continue;
    }
    const double error = depth - truth[at];
    out.worst_mm = std::max(out.worst_mm, std::abs(error));
    squares += error * error;
    relative += std::pow(error / static_cast<double>(map.sigma_mm[at]), 2);
    EXPECT_GT(map.confidence[at], 0);
  }
  out.rms_mm = std::sqrt(squares / static_cast<double>(out.depths));
  out.relative = std::sqrt(relative / static_cast<double>(out.depths));
  return out;
}

// One px of disparity is 21 mm of depth here, a period of the fringes 4 px: exact phases leave what
// interpolation bends.
TEST(StructuredLight, TwoCamerasMeetWhereTheirPhasesDo) {
  for (const Surface surface : {Surface::Plane, Surface::Wave}) {
    const StereoScene scene = scene_of(surface);
    const StructuredDepth depth =
        match_phases(scene.rig, {0, 1}, view_of(scene, 0), view_of(scene, 1), options_for());
    const Figures figures = judge(scene, depth.map);
    EXPECT_GT(figures.depths, 0.8 * static_cast<double>(figures.surface));
    EXPECT_LT(figures.rms_mm, surface == Surface::Plane ? 0.02 : 0.15);
    EXPECT_EQ(depth.ambiguous, 0U);
    EXPECT_EQ(depth.epipolar_count, 0U);
  }
}

TEST(StructuredLight, CameraAndProjectorMeetWhereThePhaseSays) {
  for (const bool rows : {false, true}) {
    const StereoScene scene = scene_of(Surface::Plane);
    DecodedView view = view_of(scene, 0, true);
    // This projector stands above the camera: columns alone tell little.
    if (!rows) {
      view.columns = view.rows;
      std::swap(view.columns, view.rows);
      view.columns.phase_rad.clear();
    }
    const StructuredDepth depth = triangulate_phases(scene.rig, 0, 0, view, options_for());
    EXPECT_EQ(depth.map.lens.distortion.k1, 0);
    const Figures figures = judge(scene, depth.map);
    EXPECT_GT(figures.depths, 0.8 * static_cast<double>(figures.surface));
    EXPECT_LT(figures.rms_mm, 0.02);
    EXPECT_EQ(depth.epipolar_count > 0, rows);
    EXPECT_LT(depth.epipolar_px, 0.01F);
  }
}

TEST(StructuredLight, SigmaTellsTheError) {
  const StereoScene scene = scene_of(Surface::Plane);
  const auto noisy = [&](std::size_t camera) { return view_of(scene, camera, true, kSigma_rad); };
  const Figures two = judge(scene, match_phases(scene.rig, {0, 1}, noisy(0), noisy(1), options_for()).map);
  const Figures one = judge(scene, triangulate_phases(scene.rig, 0, 0, noisy(0), options_for()).map);
  // Resampling averages noise, which sigma does not count on.
  EXPECT_GT(two.relative, 0.4);
  EXPECT_LT(two.relative, 1.2);
  EXPECT_GT(one.relative, 0.4);
  EXPECT_LT(one.relative, 1.2);
}

TEST(StructuredLight, EdgesAndWhatOneCameraSeesAreHoles) {
  const StereoScene scene = scene_of(Surface::Step);
  const StructuredDepth depth =
      match_phases(scene.rig, {0, 1}, view_of(scene, 0), view_of(scene, 1), options_for());
  const Figures figures = judge(scene, depth.map);
  EXPECT_LT(figures.worst_mm, options_for().break_mm);  // nothing lies between the plates
  EXPECT_GT(figures.depths, 0.75 * static_cast<double>(figures.surface));
  const StereoScene ball = scene_of(Surface::Sphere);
  const StructuredDepth round =
      match_phases(ball.rig, {0, 1}, view_of(ball, 0), view_of(ball, 1), options_for());
  const Figures of_ball = judge(ball, round.map);
  EXPECT_EQ(of_ball.invented, 0U);
  EXPECT_GT(of_ball.depths, 0.8 * static_cast<double>(of_ball.surface));
}

TEST(StructuredLight, WrongPeriodsMakeNoSurface) {
  const StereoScene scene = scene_of(Surface::Plane);
  DecodedView left = view_of(scene, 0, true);
  DecodedView right = view_of(scene, 1, true);
  // A patch of the right picture is two periods off, which is more than it is wide: what it would match has
  // another match.
  for (int y = 60; y < 100; ++y) {
    for (int x = 100; x < 107; ++x) {
      right.columns.phase_rad[static_cast<std::size_t>(y * kWidth + x)] += static_cast<float>(2 * kTurn);
    }
  }
  const Figures figures = judge(scene, match_phases(scene.rig, {0, 1}, left, right, options_for()).map);
  EXPECT_LT(figures.worst_mm, 0.5);
  EXPECT_GT(figures.depths, 0.7 * static_cast<double>(figures.surface));
}

TEST(StructuredLight, RowsTellACalibrationThatDoesNotFit) {
  const StereoScene scene = scene_of(Surface::Plane);
  const DecodedView left = view_of(scene, 0, true);
  const DecodedView right = view_of(scene, 1, true);
  EXPECT_LT(match_phases(scene.rig, {0, 1}, left, right, options_for()).epipolar_px, 0.05F);
  capture::Rig bumped = scene.rig;
  capture::Lens& lens = bumped.cameras[1].lens;
  lens.camera_from_rig = Eigen::AngleAxisd(0.8 / lens.fx_px, Eigen::Vector3d::UnitX()) * lens.camera_from_rig;
  EXPECT_NEAR(match_phases(bumped, {0, 1}, left, right, options_for()).epipolar_px, 0.8F, 0.1F);
}

TEST(StructuredLight, DepthsAreFoundWithoutBeingGiven) {
  const StereoScene scene = scene_of(Surface::Plane);
  const DecodedView left = view_of(scene, 0, true);
  const std::vector<double> truth = scene.depth_mm(scene.rig.cameras[0].lens, 0);
  const auto [nearest, farthest] = std::minmax_element(truth.begin(), truth.end());
  for (const stereo::DepthRange& depths :
       {find_depths(scene.rig, {0, 1}, left, view_of(scene, 1, true)), find_depths(scene.rig, 0, 0, left)}) {
    EXPECT_LT(static_cast<double>(depths.nearest_mm), *nearest + 20);  // corners that one camera alone sees
    EXPECT_GT(static_cast<double>(depths.nearest_mm), *nearest - 100);
    EXPECT_GT(static_cast<double>(depths.farthest_mm), *farthest - 20);
    EXPECT_LT(static_cast<double>(depths.farthest_mm), *farthest + 100);
  }
}

TEST(StructuredLight, RefusesWhatDoesNotFitTheRig) {
  const StereoScene scene = scene_of(Surface::Plane);
  const DecodedView view = view_of(scene, 0);
  const auto refusal = [](const auto& work) -> std::string {
    try {
      work();
    } catch (const Error& error) {
      return error.what();
    }
    return {};
  };
  const StructuredLightOptions options = options_for();
  DecodedView small = view;
  small.width_px -= 1;
  EXPECT_THAT(refusal([&] {
                match_phases(scene.rig, {0, 1}, small, view, options);
              }),
              HasSubstr("the rig says"));
  EXPECT_THAT(refusal([&] { match_phases(scene.rig, {1, 0}, view, view, options); }), HasSubstr("swapped"));
  DecodedView nothing = view;
  nothing.columns = {};
  EXPECT_THAT(refusal([&] {
                match_phases(scene.rig, {0, 1}, view, nothing, options);
              }),
              HasSubstr("no coded axis in common"));
  EXPECT_THAT(refusal([&] { triangulate_phases(scene.rig, 0, 0, nothing, options); }),
              HasSubstr("no coded axis"));
  EXPECT_THAT(refusal([&] { triangulate_phases(scene.rig, 0, 1, view, options); }),
              HasSubstr("no projector 1"));
  DecodedView unknown = view;
  unknown.columns.periods = 0;
  EXPECT_THAT(refusal([&] { triangulate_phases(scene.rig, 0, 0, unknown, options); }),
              HasSubstr("phase:NxF"));
}

}  // namespace
}  // namespace facet::scan
