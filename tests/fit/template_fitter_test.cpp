#include "fit/template_fitter.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "face_scene.hpp"
#include "facet/error.hpp"
#include "fit/visibility.hpp"

namespace facet::fit {
namespace {

using namespace scene;

/// Mean distance of the vertices that the maps pulled to a surface.
double mean_distance_mm(const mesh::Vertices& vertices_mm, const mesh::Vertices& truth_mm,
                        const std::vector<float>& weight) {
  const render::Raycaster caster(truth_mm, surface()->triangles);
  double sum = 0;
  int count = 0;
  for (std::size_t v = 0; v < weight.size(); ++v) {
    if (weight[v] > 0.3F) {
      sum += static_cast<double>(
          caster.closest_point(vertices_mm.col(static_cast<Eigen::Index>(v)), 50).distance_mm);
      ++count;
    }
  }
  return sum / std::max(count, 1);
}

TEST(TemplateFitter, ComesToLieOnTheDepthMaps) {
  const mesh::Vertices truth_mm = swollen();
  FitOptions options;
  options.steps = 30;
  options.cg_iterations = 200;
  TemplateFitter fitter(surface(), options);
  fitter.set_rest(rest());
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  const TemplateFitReport report = fitter.fit(depths_of(truth_mm), vertices_mm);
  EXPECT_LT(report.last_move_mm, 0.05) << to_string(report.outcome);
  EXPECT_GT(report.seen, 0.8);
  EXPECT_LT(report.surface_rms_mm, 0.2);
  EXPECT_LT(mean_distance_mm(vertices_mm, truth_mm, fitter.depth_weight()), 0.05);
  EXPECT_GT(mean_distance_mm(surface()->neutral_mm, truth_mm, fitter.depth_weight()), 1.0)
      << "or the test shows nothing";
}

TEST(TemplateFitter, AMouthThatTearsIsTold) {
  mesh::Vertices torn_mm = swollen();
  float middle_mm = 0;
  int count = 0;
  for (Eigen::Index v = 0; v < torn_mm.cols(); ++v) {
    if (surface()->is_mouth[static_cast<std::size_t>(v)] != 0) {
      EXPECT_NE(surface()->is_skin[static_cast<std::size_t>(v)], 0);
      middle_mm += torn_mm(1, v);
      ++count;
    }
  }
  ASSERT_GT(count, 8);
  middle_mm /= static_cast<float>(count);
  for (Eigen::Index v = 0; v < torn_mm.cols(); ++v) {  // the lower lip hangs behind the teeth
    torn_mm(2, v) -=
        surface()->is_mouth[static_cast<std::size_t>(v)] != 0 && torn_mm(1, v) < middle_mm ? 12.0F : 0.0F;
  }
  for (const bool torn : {false, true}) {
    FitOptions options;
    options.steps = 30;
    options.cg_iterations = 200;
    TemplateFitter fitter(surface(), options);
    fitter.set_rest(rest());
    mesh::Vertices vertices_mm = surface()->neutral_mm;
    const TemplateFitReport report = fitter.fit(depths_of(torn ? torn_mm : swollen()), vertices_mm);
    EXPECT_FALSE(report.lost);
    EXPECT_EQ(report.torn(), torn) << "bent by " << report.mouth_bend << ", off " << report.mouth_off;
  }
}

TEST(TemplateFitter, OutliersOfDepthDoNotPull) {
  const mesh::Vertices truth_mm = swollen();
  std::vector<DepthMap> maps = depths_of(truth_mm);
  for (DepthMap& map : maps) {  // a hand in front
    for (int y = 150; y < 190; ++y) {
      for (int x = 100; x < 150; ++x) {
        map.depth_mm[static_cast<std::size_t>(y) * 320 + static_cast<std::size_t>(x)] = 780;
      }
    }
  }
  FitOptions options;
  options.steps = 30;
  options.cg_iterations = 200;
  TemplateFitter fitter(surface(), options);
  fitter.set_rest(rest());
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  EXPECT_TRUE(fitter.fit(maps, vertices_mm).failure.empty());
  const std::vector<float> everywhere(static_cast<std::size_t>(vertices_mm.cols()), 1.0F);
  const render::Raycaster caster(truth_mm, surface()->triangles);
  EXPECT_LT(mean_distance_mm(vertices_mm, truth_mm, fitter.depth_weight()), 0.1);
  EXPECT_LT(mean_distance_mm(vertices_mm, truth_mm, everywhere), 0.6) << "what the hand hides is guessed";
}

/// Exact flow between two states of the mesh, by ray casting.
struct TrueFlow {
  TrueFlow(const Lens& lens, const mesh::Vertices& before_mm, const mesh::Vertices& after_mm) {
    const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
    const mesh::Triangles& triangles = surface()->triangles;
    const mesh::Vertices seen =
        (camera_from_rig.linear() * before_mm).colwise() + camera_from_rig.translation();
    const render::HitImage hits = render::Raycaster(seen, triangles)
                                      .cast({static_cast<float>(lens.fx_px), static_cast<float>(lens.fy_px),
                                             static_cast<float>(lens.cx_px), static_cast<float>(lens.cy_px),
                                             lens.width_px, lens.height_px});
    flow_px.assign(hits.triangle.size(), Eigen::Vector2f(0, 0));
    confidence.assign(hits.triangle.size(), 0.0F);
    for (std::size_t i = 0; i < hits.triangle.size(); ++i) {
      if (hits.triangle[i] >= 0) {
        const Vector3f after =
            render::interpolate(triangles, hits.triangle[i], hits.barycentric[i], after_mm);
        const Eigen::Vector2f from(static_cast<float>(i % static_cast<std::size_t>(lens.width_px)),
                                   static_cast<float>(i / static_cast<std::size_t>(lens.width_px)));
        flow_px[i] = lens.project(after.cast<double>())->cast<float>() - from;
        confidence[i] = 1;
      }
    }
    view = {lens, lens.width_px, lens.height_px, flow_px, confidence};
  }
  std::vector<Eigen::Vector2f> flow_px;
  std::vector<float> confidence;
  FlowView view;
};

TEST(TemplateFitter, FollowsTheSkinAlongTheSurface) {
  // The skin slides within a surface that hardly changes: only the flow can tell.
  const mesh::Vertices before_mm = surface()->neutral_mm;
  mesh::Vertices after_mm = before_mm;
  for (Eigen::Index v = 0; v < after_mm.cols(); ++v) {
    const Vector3f at = after_mm.col(v);
    after_mm.col(v) += 3 * std::exp(-at.head<2>().squaredNorm() / 2000) * Vector3f(1, 0.5F, 0);
  }
  const std::vector<DepthMap> maps = depths_of(after_mm);
  const TrueFlow left(lens_at(-0.3), before_mm, after_mm);
  const TrueFlow right(lens_at(0.3), before_mm, after_mm);
  const std::vector<FlowView> flows = {left.view, right.view};
  FitOptions options;
  options.steps = 40;
  options.cg_iterations = 200;
  TemplateFitter fitter(surface(), options);
  fitter.set_rest(rest());
  mesh::Vertices followed_mm = before_mm;
  const TemplateFitReport report = fitter.track(maps, flows, before_mm, followed_mm);
  EXPECT_LT(report.last_move_mm, 0.02);
  EXPECT_GT(report.followed, 0.5);
  EXPECT_LT(report.motion_rms_px, 0.3);
  mesh::Vertices alone_mm = before_mm;
  fitter.fit(maps, alone_mm);
  double drift = 0;
  double drift_alone = 0;
  int count = 0;
  for (Eigen::Index v = 0; v < after_mm.cols(); ++v) {
    if ((after_mm.col(v) - before_mm.col(v)).norm() > 1) {
      drift += static_cast<double>((after_mm.col(v) - followed_mm.col(v)).norm());
      drift_alone += static_cast<double>((after_mm.col(v) - alone_mm.col(v)).norm());
      ++count;
    }
  }
  ASSERT_GT(count, 100);
  EXPECT_LT(drift / count, 0.3);
  EXPECT_GT(drift_alone / count, 4 * drift / count);
}

TEST(TemplateFitter, KnowsTurningAndExpressionsFromBending) {
  const auto& expressions = surface()->expressions_mm;
  std::size_t largest = 0;
  for (std::size_t e = 1; e < expressions.size(); ++e) {
    largest = expressions[e].squaredNorm() > expressions[largest].squaredNorm() ? e : largest;
  }
  mesh::Vertices truth_mm = surface()->neutral_mm + 0.8F * expressions[largest];
  truth_mm = Eigen::AngleAxisf(0.12F, Vector3f::UnitY()).toRotationMatrix() * truth_mm;
  FitOptions options;
  options.steps = 40;
  options.cg_iterations = 300;
  TemplateFitter fitter(surface(), options);
  fitter.set_rest(rest());
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  fitter.fit(depths_of(truth_mm), vertices_mm);
  ASSERT_EQ(fitter.expression().size(), static_cast<Eigen::Index>(expressions.size()));
  EXPECT_NEAR(fitter.expression()[static_cast<Eigen::Index>(largest)], 0.8, 0.2);
  const double knowing = (vertices_mm - truth_mm).colwise().norm().mean();
  options.turns_with_the_head = false;
  TemplateFitter paper(surface(), options);
  paper.set_rest(rest());
  vertices_mm = surface()->neutral_mm;
  paper.fit(depths_of(truth_mm), vertices_mm);
  EXPECT_LT(knowing, 0.5 * static_cast<double>((vertices_mm - truth_mm).colwise().norm().mean()));
}

TEST(TemplateFitter, TheModelMovesFirst) {
  // A jaw that opens by centimetres within a step: the displacements alone are not there yet.
  const auto& expressions = surface()->expressions_mm;
  std::size_t largest = 0;
  for (std::size_t e = 1; e < expressions.size(); ++e) {
    largest = expressions[e].squaredNorm() > expressions[largest].squaredNorm() ? e : largest;
  }
  const mesh::Vertices truth_mm = surface()->neutral_mm + 0.7F * expressions[largest];
  const auto error_mm = [&](int model_steps) {
    FitOptions options;
    options.steps = 1;
    options.model_steps = model_steps;
    TemplateFitter fitter(surface(), options);
    fitter.set_rest(rest());
    mesh::Vertices vertices_mm = surface()->neutral_mm;
    fitter.fit(depths_of(truth_mm), vertices_mm);
    return static_cast<double>((vertices_mm - truth_mm).colwise().norm().mean());
  };
  EXPECT_LT(error_mm(4), 0.6 * error_mm(0));
}

TEST(TemplateFitter, TurnsNoTriangleOver) {
  // A flow that is wrong by far on a spot of the cheek, trusted more than the template's stiffness.
  const mesh::Vertices truth_mm = surface()->neutral_mm;
  const Lens lens = lens_at(0);
  TrueFlow wrong(lens, truth_mm, truth_mm);
  for (int y = 170; y < 184; ++y) {
    for (int x = 190; x < 204; ++x) {
      wrong.flow_px[static_cast<std::size_t>(y) * 320 + static_cast<std::size_t>(x)] = {-18, 0};
    }
  }
  const auto folded = [&](bool unfolds, int& unfolded) {
    FitOptions options;
    options.alpha = 0.01;
    options.beta = 20;
    options.sigma_m_px = 100;
    options.cg_iterations = 200;
    options.model_steps = 0;
    options.unfolds = unfolds;
    TemplateFitter fitter(surface(), options);
    fitter.set_rest(rest());
    mesh::Vertices vertices_mm = truth_mm;
    unfolded =
        fitter.track(depths_of(truth_mm), std::vector<FlowView>{wrong.view}, truth_mm, vertices_mm).unfolded;
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(vertices_mm, surface()->triangles, normals);
    int count = 0;
    for (Eigen::Index t = 0; t < surface()->triangles.cols(); ++t) {
      const auto corner = surface()->triangles.col(t);
      const Vector3f across = (vertices_mm.col(corner[1]) - vertices_mm.col(corner[0]))
                                  .cross(vertices_mm.col(corner[2]) - vertices_mm.col(corner[0]));
      count +=
          across.dot(normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2])) < 0 ? 1 : 0;
    }
    return count;
  };
  int unfolded = 0;
  EXPECT_GT(folded(false, unfolded), 0) << "or the test shows nothing";
  EXPECT_EQ(unfolded, 0);
  EXPECT_EQ(folded(true, unfolded), 0);
  EXPECT_GT(unfolded, 0);
}

TEST(TemplateFitter, WhatHasNoSkinGoesWhereTheSkinAroundItGoes) {
  // A loose ball behind a sheet, as an eyeball behind its lids.
  TemplateMesh made;
  constexpr int kSide = 12;
  made.neutral_mm.resize(3, kSide * kSide + 4);
  std::vector<Eigen::Vector3i> corners;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      made.neutral_mm.col(y * kSide + x) =
          Vector3f(10.0F * static_cast<float>(x) - 55, 10.0F * static_cast<float>(y) - 55, 0);
      if (x + 1 < kSide && y + 1 < kSide) {
        const int at = y * kSide + x;
        corners.emplace_back(at, at + 1, at + kSide);
        corners.emplace_back(at + 1, at + kSide + 1, at + kSide);
      }
    }
  }
  const int ball = kSide * kSide;
  made.neutral_mm.rightCols(4) << -4, 4, 0, 0, -4, -4, 5, 0, -5, -5, -5, -12;
  for (const Eigen::Vector3i& face : {Eigen::Vector3i(0, 1, 2), {0, 3, 1}, {1, 3, 2}, {2, 3, 0}}) {
    corners.emplace_back(face.array() + ball);
  }
  made.triangles.resize(3, static_cast<Eigen::Index>(corners.size()));
  for (std::size_t t = 0; t < corners.size(); ++t) {
    made.triangles.col(static_cast<Eigen::Index>(t)) = corners[t];
  }
  made.one_rings = mesh::build_one_rings(made.triangles, ball + 4);
  made.is_skin.assign(static_cast<std::size_t>(ball), 1);
  made.is_skin.resize(static_cast<std::size_t>(ball) + 4, 0);
  mesh::Vertices truth_mm = made.neutral_mm.colwise() + Vector3f(0, 0, 6);
  const auto surface = std::make_shared<const TemplateMesh>(std::move(made));
  FitOptions options;
  options.steps = 20;
  options.cg_iterations = 200;
  options.turns_with_the_head = false;  // so that nothing but E_r carries it
  TemplateFitter fitter(surface, options);
  fitter.set_rest({surface->neutral_mm, {}});
  mesh::Vertices vertices_mm = surface->neutral_mm;
  fitter.fit(std::vector<DepthMap>{depth_of(truth_mm, lens_at(0), surface->triangles)}, vertices_mm);
  EXPECT_LT((vertices_mm - truth_mm).rightCols(4).row(2).cwiseAbs().maxCoeff(), 0.5F);
}

TEST(TemplateFitter, AFlowMayLeadAwayFromAnotherMesh) {
  const mesh::Vertices truth_mm = surface()->neutral_mm;
  mesh::Vertices slid_mm = truth_mm;  // where the mesh has drifted to
  for (Eigen::Index v = 0; v < slid_mm.cols(); ++v) {
    const Vector3f at = slid_mm.col(v);
    slid_mm.col(v) += 2 * std::exp(-at.head<2>().squaredNorm() / 2000) * Vector3f(1, 0.5F, 0);
  }
  const std::vector<DepthMap> maps = depths_of(truth_mm);
  const TrueFlow left(lens_at(-0.3), slid_mm, truth_mm);
  const TrueFlow right(lens_at(0.3), slid_mm, truth_mm);
  std::vector<FlowView> flows = {left.view, right.view};
  for (FlowView& flow : flows) {
    flow.from_mm = &slid_mm;
    flow.sigma_px = 4;
  }
  FitOptions options;
  options.steps = 20;
  options.cg_iterations = 200;
  TemplateFitter fitter(surface(), options);
  fitter.set_rest(rest());
  mesh::Vertices back_mm = slid_mm;
  const mesh::Vertices elsewhere_mm = slid_mm.colwise() + Vector3f(7, 0, 0);
  const TemplateFitReport report = fitter.track(maps, flows, elsewhere_mm, back_mm);
  EXPECT_GT(report.followed, 0.5);
  double before = 0;
  double after = 0;
  for (Eigen::Index v = 0; v < truth_mm.cols(); ++v) {
    if ((slid_mm.col(v) - truth_mm.col(v)).norm() > 1) {
      before += static_cast<double>((slid_mm.col(v) - truth_mm.col(v)).norm());
      after += static_cast<double>((back_mm.col(v) - truth_mm.col(v)).norm());
    }
  }
  ASSERT_GT(before, 100);
  EXPECT_LT(after, 0.25 * before);
  const mesh::Vertices other = mesh::Vertices::Zero(3, 7);
  flows[0].from_mm = &other;
  EXPECT_THROW(fitter.track(maps, flows, elsewhere_mm, back_mm), Error);
}

// Beside the nose, where a map shows the cheek behind it.
TEST(TemplateFitter, WhatLiesBehindAnEdgeDoesNotPull) {
  const mesh::Vertices before_mm = surface()->neutral_mm;
  std::vector<DepthMap> maps = depths_of(before_mm);
  for (DepthMap& map : maps) {
    for (int y = 120; y < 180; ++y) {
      for (int x = 140; x < 180; ++x) {
        float& depth = map.depth_mm[static_cast<std::size_t>(y) * 320 + static_cast<std::size_t>(x)];
        depth += depth > 0 ? 9 : 0;
      }
    }
  }
  const auto most_moved = [&](double sigma_mm) {
    FitOptions options;
    options.sigma_s_mm = sigma_mm;
    TemplateFitter fitter(surface(), options);
    fitter.set_rest(rest());
    mesh::Vertices vertices_mm = before_mm;
    fitter.track(maps, {}, before_mm, vertices_mm);
    return (vertices_mm - before_mm).colwise().norm().maxCoeff();
  };
  EXPECT_LT(most_moved(FitOptions().sigma_s_mm), 0.5F);
  EXPECT_GT(most_moved(20), 4.0F) << "the paper's";
}

TEST(TemplateFitter, MovesAsAWhole) {
  const mesh::Vertices truth_mm = (Eigen::AngleAxisf(0.03F, Vector3f::UnitY()).toRotationMatrix() *
                                   (surface()->neutral_mm + 0.3F * surface()->expressions_mm.front()))
                                      .colwise() +
                                  Vector3f(1, 2, 5);
  TemplateFitter fitter(surface(), {});
  fitter.set_rest(rest());
  const mesh::Vertices before_mm = surface()->neutral_mm;
  mesh::Vertices vertices_mm = before_mm;
  const TrueFlow flow(lens_at(0), before_mm, truth_mm);
  fitter.move(depths_of(truth_mm), std::vector<FlowView>{flow.view}, before_mm, vertices_mm);
  EXPECT_LT((vertices_mm - truth_mm).colwise().norm().mean(), 0.3F);
  EXPECT_GT((before_mm - truth_mm).colwise().norm().mean(), 5.0F);
  // Where nothing is seen it stays.
  const mesh::Vertices moved_mm = vertices_mm;
  fitter.move({}, {}, before_mm, vertices_mm);
  EXPECT_EQ(vertices_mm, moved_mm);
  mesh::Vertices other = mesh::Vertices::Zero(3, 7);
  EXPECT_THROW(fitter.move({}, {}, before_mm, other), Error);
}

TEST(TemplateFitter, KnowsWhenItIsLost) {
  TemplateFitter fitter(surface(), {});
  fitter.set_rest(rest());
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  TemplateFitReport report = fitter.fit(depths_of(swollen()), vertices_mm);
  EXPECT_FALSE(report.lost) << report.lost_because;
  EXPECT_LT(report.rejected, 0.02);
  // The face is 12 mm nearer than where it was left.
  const std::vector<DepthMap> maps = depths_of(surface()->neutral_mm.colwise() + Vector3f(0, 0, 12));
  FitOptions one;
  one.steps = 1;
  one.model_steps = 0;  // or it would be found
  TemplateFitter there(surface(), one);
  there.set_rest(rest());
  vertices_mm = surface()->neutral_mm;
  report = there.fit(maps, vertices_mm);
  EXPECT_TRUE(report.lost);
  EXPECT_THAT(report.lost_because, ::testing::HasSubstr("off the depth maps"));
  // Nothing is seen.
  vertices_mm = surface()->neutral_mm;
  report = fitter.fit({}, vertices_mm);
  EXPECT_TRUE(report.lost);
  EXPECT_THAT(report.lost_because, ::testing::HasSubstr("on a depth map"));
  // Flow that leads nowhere.
  vertices_mm = surface()->neutral_mm;
  TrueFlow nowhere(lens_at(0), vertices_mm, vertices_mm);
  std::fill(nowhere.confidence.begin(), nowhere.confidence.end(), 0.1F);
  nowhere.view.confidence = nowhere.confidence;
  const mesh::Vertices before_mm = vertices_mm;
  report = fitter.track(depths_of(vertices_mm), std::vector<FlowView>{nowhere.view}, before_mm, vertices_mm);
  EXPECT_TRUE(report.lost);
  EXPECT_THAT(report.lost_because, ::testing::HasSubstr("flow"));
}

TEST(TemplateFitter, ComesBackAsTheSamePerson) {
  // The person's own shape, elsewhere and with another expression, as landmarks alone place it: the mean's
  // shape.
  TemplateFitter fitter(surface(), {});
  RestShape person = rest();
  person.vertices_mm = swollen();
  fitter.set_rest(person);
  const Eigen::AngleAxisf turn(0.3F, Vector3f::UnitY());
  const auto moved = [&](const mesh::Vertices& shape) {
    return mesh::Vertices((turn.toRotationMatrix() * shape).colwise() + Vector3f(20, -10, 30));
  };
  const mesh::Vertices truth_mm = moved(person.vertices_mm + 0.6F * person.expressions_mm[1]);
  mesh::Vertices placed_mm = truth_mm;
  for (Eigen::Index v = 0; v < placed_mm.cols(); ++v) {
    placed_mm.col(v) +=
        1.5F * Vector3f(std::sin(0.7F * static_cast<float>(v)), std::cos(1.1F * static_cast<float>(v)), 0.3F);
  }
  const mesh::Vertices found_mm = fitter.shape_like(placed_mm);
  EXPECT_LT((found_mm - truth_mm).colwise().norm().mean(), 0.7F);
  EXPECT_THROW(fitter.shape_like(mesh::Vertices::Zero(3, 7)), Error);
}

TEST(TemplateFitter, ExpectsThatAVertexGoesOnAsItWent) {
  const mesh::Vertices& truth_mm = surface()->neutral_mm;
  const auto run = [&](double gamma, float move_mm) {
    FitOptions options;
    options.gamma = gamma;
    TemplateFitter fitter(surface(), options);
    fitter.set_rest(rest());
    std::mt19937_64 random(5);
    std::normal_distribution<float> noise(0, 0.3F);
    mesh::Vertices vertices_mm = truth_mm;
    mesh::Vertices last_mm;
    mesh::Vertices older_mm;
    double squares = 0;
    double error = 0;
    for (int m = 0; m < 7; ++m) {
      const mesh::Vertices now_mm = truth_mm.colwise() + Vector3f(0, 0, move_mm * static_cast<float>(m));
      std::vector<DepthMap> maps = depths_of(now_mm);
      for (DepthMap& map : maps) {
        for (float& depth : map.depth_mm) {
          depth += depth > 0 ? noise(random) : 0.0F;
        }
      }
      fitter.fit(maps, vertices_mm);
      fitter.remember(vertices_mm);
      if (m > 3) {
        squares += static_cast<double>((vertices_mm - 2 * last_mm + older_mm).squaredNorm());
        error = static_cast<double>((vertices_mm - now_mm).row(2).mean());
      }
      older_mm = last_mm;
      last_mm = vertices_mm;
    }
    return std::pair(squares, std::abs(error));
  };
  EXPECT_LT(run(1, 0).first, 0.8 * run(0, 0).first) << "quieter on a still face";
  EXPECT_LT(run(1, 8).second, run(0, 8).second + 0.2) << "no lag behind a face that moves by 8 mm a mesh";
  TemplateFitter fitter(surface(), {});
  EXPECT_THROW(fitter.remember(mesh::Vertices::Zero(3, 7)), Error);
}

TEST(TemplateFitter, WithoutDepthItStaysWhereItIsAndSaysSo) {
  TemplateFitter fitter(surface(), {});
  fitter.set_rest(rest());
  mesh::Vertices vertices_mm = swollen();
  const mesh::Vertices given = vertices_mm;
  EXPECT_EQ(fitter.fit({}, vertices_mm).outcome, TemplateFitOutcome::NoData);
  EXPECT_EQ(vertices_mm, given);
  // A face that has left the volume: the maps see something else.
  const std::vector<DepthMap> maps = depths_of(surface()->neutral_mm.colwise() + Vector3f(0, 0, 300));
  const TemplateFitReport report = fitter.fit(maps, vertices_mm);
  EXPECT_EQ(report.outcome, TemplateFitOutcome::NoData);
  EXPECT_THAT(report.failure, ::testing::HasSubstr("of the template's skin lies on a depth map"));
  EXPECT_EQ(vertices_mm, given);
}

TEST(TemplateFitter, NumbersThatAreNoneDoNoHarm) {
  TemplateFitter fitter(surface(), {});
  fitter.set_rest(rest());
  std::vector<DepthMap> maps = depths_of(surface()->neutral_mm);
  for (std::size_t i = 0; i < maps[0].depth_mm.size(); i += 3) {
    maps[0].depth_mm[i] =
        i % 2 == 0 ? std::numeric_limits<float>::quiet_NaN() : std::numeric_limits<float>::infinity();
  }
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  const TemplateFitReport report = fitter.fit(maps, vertices_mm);
  EXPECT_NE(report.outcome, TemplateFitOutcome::NumericalFailure);
  EXPECT_TRUE(vertices_mm.allFinite());
}

TEST(TemplateFitter, WrongUseIsNamed) {
  FitOptions options;
  options.alpha = 0;
  EXPECT_THROW(TemplateFitter(surface(), options), Error);
  TemplateFitter fitter(surface(), {});
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  EXPECT_THAT([&] { fitter.fit({}, vertices_mm); },
              ::testing::ThrowsMessage<Error>(::testing::HasSubstr("no rest shape")));
  EXPECT_THROW(fitter.set_rest({mesh::Vertices::Zero(3, 7), {}}), Error);
}

TEST(FindVisible, HidesWhatIsBehindAndTheRim) {
  // A small plate in front of a large one.
  mesh::Vertices vertices_mm(3, 8);
  vertices_mm << -100, 100, 100, -100, -30, 30, 30, -30, -100, -100, 100, 100, -30, -30, 30, 30, 0, 0, 0, 0,
      50, 50, 50, 50;
  mesh::Triangles triangles(3, 4);
  triangles << 0, 0, 4, 4, 1, 2, 5, 6, 2, 3, 6, 7;
  Eigen::Matrix3Xf normals = Eigen::Matrix3Xf::Zero(3, 8);
  normals.row(2).setOnes();
  Lens lens = lens_at(0);
  std::vector<std::uint8_t> visible;
  find_visible(lens, vertices_mm, normals, triangles, 1, 0, visible);
  EXPECT_THAT(visible, ::testing::Each(1));
  find_visible(lens, vertices_mm, normals, triangles, 1, 5, visible);
  EXPECT_THAT(visible, ::testing::Each(0)) << "all of them lie at a rim";
  normals.row(2).setConstant(-1);
  find_visible(lens, vertices_mm, normals, triangles, 1, 0, visible);
  EXPECT_THAT(visible, ::testing::Each(0)) << "turned away";
  normals.row(2).setOnes();
  // The small plate moves before a corner of the large one.
  vertices_mm.rightCols(4).row(0).array() += 90;
  vertices_mm.rightCols(4).row(1).array() += 90;
  find_visible(lens, vertices_mm, normals, triangles, 1, 0, visible);
  EXPECT_THAT(visible, ::testing::ElementsAre(1, 1, 0, 1, 1, 1, 1, 1));
}

}  // namespace
}  // namespace facet::fit
