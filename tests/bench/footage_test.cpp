// Figures of footage without a truth, on frames of which one is known.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "footage/face_views.hpp"
#include "footage/figures.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "take/recorder.hpp"

namespace facet::footage {
namespace {

std::vector<Moment> moments(const std::vector<std::pair<double, float>>& times_and_weights) {
  std::vector<Moment> all;
  for (const auto& [time_s, weight] : times_and_weights) {
    all.push_back({static_cast<std::int64_t>(all.size()), time_s, 7, {weight, 0.5F}});
  }
  return all;
}

TEST(ChoosePairs, TakesAlikeFramesThatAreFarApartInTime) {
  // 0 and 1 are alike but near in time; 0 and 3 are alike and far; 1 and 4 less so.
  const auto all = moments({{0, 0.1F}, {0.5, 0.11F}, {1, 0.9F}, {3, 0.12F}, {4, 0.2F}});
  const auto pairs = choose_pairs(all, Expressions::Alike, 2, 2);
  ASSERT_EQ(pairs.size(), 2U);
  EXPECT_EQ(std::pair(pairs[0].first, pairs[0].second), std::pair(std::int64_t{1}, std::int64_t{3}));
  EXPECT_NEAR(pairs[0].distance, 0.01, 1e-6);
  // 1 and 3 are taken: what is left are 0 and 4, then 2 alone.
  EXPECT_EQ(std::pair(pairs[1].first, pairs[1].second), std::pair(std::int64_t{0}, std::int64_t{4}));
  EXPECT_EQ(choose_pairs(all, Expressions::Alike, 2, 9).size(), 2U);
  EXPECT_EQ(choose_pairs(all, Expressions::Alike, 2, 1).size(), 1U);
}

TEST(ChoosePairs, TakesUnlikeOnesAndNeverTwoSubjects) {
  auto all = moments({{0, 0.1F}, {0.1, 0.5F}, {3, 0.9F}, {3.1, 0.2F}});
  auto pairs = choose_pairs(all, Expressions::Unlike, 2, 9);
  ASSERT_EQ(pairs.size(), 2U);
  EXPECT_EQ(std::pair(pairs[0].first, pairs[0].second), std::pair(std::int64_t{0}, std::int64_t{2}));
  EXPECT_NEAR(pairs[0].distance, 0.8, 1e-6);
  all[2].subject_id = 8;
  pairs = choose_pairs(all, Expressions::Unlike, 2, 9);
  ASSERT_EQ(pairs.size(), 1U);
  EXPECT_EQ(std::pair(pairs[0].first, pairs[0].second), std::pair(std::int64_t{1}, std::int64_t{3}));
  EXPECT_TRUE(choose_pairs(all, Expressions::Unlike, 4, 9).empty());
}

TEST(Repeatability, FindsFoldsThatComeBackWithTheirExpression) {
  const test::TemporaryFolder folder;
  const auto subject = test::patch_subject(7, 17, 4);
  take::TakeRecorder recorder({.file = folder.path() / "test.take",
                               .source = "none",
                               .software = "test",
                               .when_full = take::WhenFull::Wait,
                               .disk_reserve_bytes = 0});
  recorder.start();
  std::uint64_t sequence = 0;
  for (const auto& [time_s, weight] :
       std::vector<std::pair<double, float>>{{0, 0.1F}, {1, 0.9F}, {3, 0.1F}, {4, 0.9F}}) {
    // The folds of a frame are those of its expression.
    auto frame =
        std::make_shared<mesh::MeshFrame>(test::patch_frame(weight > 0.5F ? 90 : 10, subject, nullptr));
    frame->sequence = sequence++;
    frame->media_time_ns = static_cast<std::int64_t>(time_s * 1e9);
    frame->expression.assign(subject->expression_names.size(), weight);
    recorder.record(frame);
  }
  recorder.request_stop();
  recorder.stop();
  take::TakeReader take(folder.path() / "test.take");
  std::array<take::TakeReader*, 1> takes{&take};
  int told = 0;
  const auto alike = repeatability(takes, Expressions::Alike, 2, 9, [&] { ++told; });
  EXPECT_EQ(alike.pairs, 2);
  EXPECT_EQ(told, 2);
  EXPECT_NEAR(alike.distance, 0, 1e-6);
  EXPECT_NEAR(alike.correlation, 1, 1e-6);
  EXPECT_GT(alike.share, 0.9);
  const auto unlike = repeatability(takes, Expressions::Unlike, 2, 9, [] {});
  EXPECT_EQ(unlike.pairs, 2);
  EXPECT_NEAR(unlike.distance, 0.8 * std::sqrt(3.0), 1e-5);
  EXPECT_NEAR(unlike.correlation, 0, 0.15);
  const auto none = repeatability(takes, Expressions::Alike, 20, 9, [] {});
  EXPECT_EQ(none.pairs, 0);
  EXPECT_TRUE(std::isnan(none.correlation));
}

/// A model of the patch with one identity that bulges it and one expression that moves its lower half.
face::FaceModel patch_model(const mesh::Subject& subject, const mesh::MeshFrame& frame) {
  face::FaceModel model;
  model.control.vertex_count = subject.hierarchy->control_vertex_count;
  model.regions = subject.regions;
  model.expression_names = {"jawOpen"};
  model.identity_modes = 2;
  model.expression_modes = 2;
  model.core_mm.assign(static_cast<std::size_t>(2 * 2 * 3 * model.vertex_count()), 0.0F);
  model.core_row(0, 0) = frame.control_vertices_mm;
  for (Eigen::Index v = 0; v < model.vertex_count(); ++v) {
    const Eigen::Vector3f at = frame.control_vertices_mm.col(v);
    model.core_row(1, 0)(2, v) = 5 * std::cos(at.x() / 20);
    model.core_row(0, 1)(1, v) = at.y() < 0 ? -10.0F : 0.0F;
  }
  return model;
}

mesh::MeshFrame half(const face::FaceModel& model, const std::shared_ptr<mesh::Subject>& subject,
                     float identity, float expression) {
  subject->identity = {identity};
  mesh::MeshFrame frame = test::patch_frame(5, subject, test::patch_albedo(*subject));
  frame.expression = {expression};
  model.evaluate(subject->identity, frame.expression, frame.control_vertices_mm);
  return frame;
}

std::shared_ptr<mesh::Subject> another_subject() {
  return std::make_shared<mesh::Subject>(*test::patch_subject());
}

TEST(Halves, ComparesNeutralShapesWhateverTheExpression) {
  const auto subject = another_subject();
  const auto model = patch_model(*subject, test::patch_frame(1, subject, nullptr));
  const auto first = half(model, subject, 0.3F, 0.9F);
  EXPECT_NEAR(compare_halves(model, first, half(model, another_subject(), 0.3F, 0.1F)).shape_mm, 0, 1e-4);
  const double little = compare_halves(model, first, half(model, another_subject(), 0.4F, 0.9F)).shape_mm;
  const double much = compare_halves(model, first, half(model, another_subject(), 1.3F, 0.9F)).shape_mm;
  EXPECT_GT(little, 0.05);
  EXPECT_GT(much, 5 * little);
  // One camera does not know the scale.
  auto larger = half(model, another_subject(), 0.3F, 0);
  larger.control_vertices_mm *= 1.05F;
  EXPECT_NEAR(compare_halves(model, half(model, subject, 0.3F, 0), larger).shape_mm, 0, 1e-3);
}

TEST(Halves, ComparesAlbedosUpToOneGain) {
  const auto subject = another_subject();
  const auto model = patch_model(*subject, test::patch_frame(1, subject, nullptr));
  const auto first = half(model, subject, 0, 0);
  auto second = half(model, another_subject(), 0, 0);
  auto albedo = std::make_shared<mesh::Albedo>(*first.albedo);
  for (float& value : albedo->linear_rgb) {
    value *= 0.5F;
  }
  second.albedo = albedo;
  auto halves = compare_halves(model, first, second);
  EXPECT_NEAR(halves.albedo_rms, 0, 1e-5);
  EXPECT_GT(halves.albedo_spread, 0.03);
  EXPECT_GT(halves.albedo_points, 50);
  auto spotted = std::make_shared<mesh::Albedo>(*albedo);
  for (std::size_t v = 0; 3 * v < spotted->linear_rgb.size(); ++v) {
    for (std::size_t channel = 0; channel < 3; ++channel) {
      spotted->linear_rgb[3 * v + channel] += v % 2 == 0 ? 0.04F : -0.04F;
    }
  }
  second.albedo = spotted;
  halves = compare_halves(model, first, second);
  EXPECT_NEAR(halves.albedo_rms, 0.04, 0.004);
  second.albedo = nullptr;
  EXPECT_THROW(compare_halves(model, first, second), Error);
  face::FaceModel other = model;
  other.control.vertex_count += 1;
  EXPECT_THROW(compare_halves(other, first, first), Error);
}

/// The patch in one albedo under its light, as its camera sees it.
Frame image_of(const mesh::MeshFrame& frame) {
  const auto geometry = report::geometry_of(frame);
  const auto& triangles = frame.subject->hierarchy->finest().triangles;
  const mesh::Vertices albedo =
      Eigen::Map<const mesh::Vertices>(frame.albedo->linear_rgb.data(), 3, geometry.refined_mm.cols());
  return render::to_frame(report::render_colours(
      render::Raycaster(geometry.refined_mm, triangles), triangles,
      lit_colours(albedo, geometry.refined_normals, frame.lighting), frame.camera,
      render::plain_picture(frame.camera.width_px, frame.camera.height_px, {0, 0, 0})));
}

mesh::MeshFrame lit_frame(const std::shared_ptr<const mesh::Subject>& subject, float light) {
  mesh::MeshFrame frame = test::patch_frame(4, subject, nullptr);
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = 1;
  albedo->linear_rgb.assign(3 * frame.displacements_mm.size(), 0.5F);
  frame.albedo = albedo;
  frame.lighting = {light, 0, 0.4F};
  const auto geometry = report::geometry_of(frame);
  for (std::size_t v = 0; v < frame.displacements_mm.size(); ++v) {
    frame.displacements_mm[v] = 1.5F * std::sin(geometry.coarse_mm(1, static_cast<Eigen::Index>(v)) / 6);
  }
  return frame;
}

TEST(Prediction, TakesLightAlbedoAndDisplacementsOfTheEarlierFrame) {
  const auto subject = test::patch_subject(7, 17, 3);
  const auto frame = lit_frame(subject, 0.8F);
  const Frame image = image_of(frame);
  const auto same = prediction_errors(frame, frame, image, image);
  ASSERT_TRUE(same.has_value());
  EXPECT_LT(same->fitted, 0.02);
  EXPECT_EQ(same->predicted, same->fitted);
  EXPECT_EQ(same->before, 0);
  EXPECT_GT(same->coarse, 3 * same->fitted);  // the folds are seen in the image

  // A frame as before but under half the light: the earlier picture and what is foretold are off by that
  // half.
  const auto earlier = lit_frame(subject, 0.4F);
  const auto dimmer = prediction_errors(frame, earlier, image, image_of(earlier));
  ASSERT_TRUE(dimmer.has_value());
  EXPECT_EQ(dimmer->fitted, same->fitted);
  EXPECT_NEAR(dimmer->predicted, 0.2, 0.02);
  EXPECT_NEAR(dimmer->before, 0.2, 0.02);

  // The same face at another place: the earlier picture is wrong, what is foretold is not.
  auto moved = frame;
  moved.camera_from_head.pretranslate(Eigen::Vector3f(25, 0, 0));
  const auto elsewhere = prediction_errors(moved, frame, image_of(moved), image);
  ASSERT_TRUE(elsewhere.has_value());
  EXPECT_LT(elsewhere->predicted, 0.02);
  EXPECT_GT(elsewhere->before, 0.03);
}

TEST(Prediction, SaysNothingOfAFaceThatIsNotSeen) {
  auto away = lit_frame(test::patch_subject(), 0.8F);
  away.camera_from_head.rotate(Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitY()));
  const Frame image = image_of(away);
  EXPECT_FALSE(prediction_errors(away, away, image, image).has_value());
}

}  // namespace
}  // namespace facet::footage
