#include "fit/skin_tracker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "face_scene.hpp"
#include "facet/error.hpp"
#include "maths/srgb.hpp"

namespace facet::fit {
namespace {

using namespace scene;
using Paint = std::function<float(const Vector3f&)>;  ///< brightness of the skin, by its place at rest

/// One person's skin and another's.
Paint skin(float seed) {
  return [seed](const Vector3f& at) {
    return 128 + 35 * std::sin(0.31F * at.x() + seed + std::sin(0.13F * at.y())) +
           35 * std::sin(0.27F * at.y() + 2 * seed + std::cos(0.11F * at.x() + seed));
  };
}

std::vector<Lens> colour_lenses() {
  return {lens_at(-0.2), lens_at(0.2)};
}

/// From one side and above: the nose's shadow falls on a cheek.
std::vector<Lens> projector_lenses() {
  Lens lens = lens_at(-0.7);
  lens.camera_from_rig = lens.camera_from_rig * Eigen::AngleAxisd(-0.3, Vector3d::UnitX());
  return {lens};
}

/// Shares of the light that everything gets.
Eigen::VectorXf even_light(const render::Raycaster&, const mesh::Vertices& vertices_mm) {
  return Eigen::VectorXf::Ones(vertices_mm.cols());
}

/// The projector's, with shadows cast by the mesh, and the room's.
Eigen::VectorXf projector_light(const render::Raycaster& caster, const mesh::Vertices& vertices_mm) {
  const Vector3f centre_mm = projector_lenses().front().centre_mm().cast<float>();
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, surface()->triangles, normals);
  Eigen::VectorXf light = Eigen::VectorXf::Constant(vertices_mm.cols(), 0.1F);
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const float cosine = normals.col(v).dot((centre_mm - vertices_mm.col(v)).normalized());
    if (cosine > 0 && !caster.occluded(vertices_mm.col(v) + normals.col(v), centre_mm, 0)) {
      light[v] += cosine;
    }
  }
  return light;
}

using Light = Eigen::VectorXf(const render::Raycaster&, const mesh::Vertices&);

Frame picture_of(const mesh::Vertices& vertices_mm, const Lens& lens, const Paint& paint, Light& light) {
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Triangles& triangles = surface()->triangles;
  const mesh::Vertices seen =
      (camera_from_rig.linear() * vertices_mm).colwise() + camera_from_rig.translation();
  const Eigen::Matrix3Xf lit =
      light(render::Raycaster(vertices_mm, triangles), vertices_mm).transpose().replicate(3, 1);
  const render::HitImage hits = render::Raycaster(seen, triangles)
                                    .cast({static_cast<float>(lens.fx_px), static_cast<float>(lens.fy_px),
                                           static_cast<float>(lens.cx_px), static_cast<float>(lens.cy_px),
                                           lens.width_px, lens.height_px});
  Frame frame;
  frame.width_px = lens.width_px;
  frame.height_px = lens.height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(lens.width_px);
  auto pixels = std::make_shared<std::uint8_t[]>(4 * hits.triangle.size());
  for (std::size_t i = 0; i < hits.triangle.size(); ++i) {
    float grey = 20;
    if (hits.triangle[i] >= 0) {
      const float albedo =
          maths::decode_srgb(paint(render::interpolate(triangles, hits.triangle[i], hits.barycentric[i],
                                                       surface()->neutral_mm)) /
                             255);
      const float given = render::interpolate(triangles, hits.triangle[i], hits.barycentric[i], lit).x();
      grey = 255 * maths::encode_srgb(std::min(1.0F, albedo * given));
    }
    std::fill_n(pixels.get() + static_cast<std::ptrdiff_t>(4 * i), 3,
                static_cast<std::uint8_t>(std::lround(grey)));
    pixels[static_cast<std::ptrdiff_t>(4 * i + 3)] = 255;
  }
  frame.pixels = std::move(pixels);
  return frame;
}

std::vector<Frame> pictures_of(const mesh::Vertices& vertices_mm, const Paint& paint,
                               Light& light = even_light) {
  std::vector<Frame> pictures;
  for (const Lens& lens : colour_lenses()) {
    pictures.push_back(picture_of(vertices_mm, lens, paint, light));
  }
  return pictures;
}

/// The skin slides within a surface that hardly changes, by 0.9 mm a slot, while the head turns.
mesh::Vertices performance(int slot) {
  const auto time = static_cast<float>(slot);
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f at = vertices_mm.col(v);
    vertices_mm.col(v) +=
        0.9F * time * std::exp(-at.head<2>().squaredNorm() / 2000) * Vector3f(0.9F, 0.45F, 0);
  }
  return Eigen::AngleAxisf(0.02F * time, Vector3f::UnitY()).toRotationMatrix() * vertices_mm;
}

/// Nobody does anything.
void at_rest(Placement& placed) {
  placed.shown_mm = placed.rest.vertices_mm;
  placed.expression = Eigen::VectorXd::Zero(std::ssize(placed.rest.expressions_mm));
}

/// The template where landmarks put it: off by some mm.
Placement placed_at(const mesh::Vertices& truth_mm) {
  Placement placed;
  placed.rest = rest();
  placed.rest.vertices_mm = truth_mm;
  for (Eigen::Index v = 0; v < truth_mm.cols(); ++v) {
    placed.rest.vertices_mm.col(v) +=
        1.2F * Vector3f(std::sin(0.7F * static_cast<float>(v)), std::cos(1.1F * static_cast<float>(v)), 0.3F);
  }
  at_rest(placed);
  return placed;
}

/// Placed without an error, so that what is measured is drift alone.
Placement placed_well() {
  Placement placed;
  placed.rest = rest();
  at_rest(placed);
  return placed;
}

/// How far the vertices in the middle of the face are from their skin.
double drift_mm(const SkinTracker& tracker, const mesh::Vertices& truth_mm) {
  double sum = 0;
  int count = 0;
  for (Eigen::Index v = 0; v < truth_mm.cols(); ++v) {
    if (surface()->is_skin[static_cast<std::size_t>(v)] != 0 && surface()->neutral_mm(2, v) > 0 &&
        surface()->neutral_mm.col(v).head<2>().norm() < 45) {
      sum += static_cast<double>((truth_mm.col(v) - tracker.vertices_mm().col(v)).norm());
      ++count;
    }
  }
  EXPECT_GT(count, 100);
  return sum / std::max(count, 1);
}

TEST(SkinTracker, FollowsTheSkinWithoutDrift) {
  const auto drift_after = [](const SkinTrackerOptions& options, bool with_pictures) {
    SkinTracker tracker(surface(), colour_lenses(), {}, options);
    for (int slot = 0; slot < 8; ++slot) {
      const mesh::Vertices truth_mm = performance(slot);
      const auto pictures = with_pictures ? pictures_of(truth_mm, skin(1)) : std::vector<Frame>(2);
      const TemplateFitReport report = slot == 0 ? tracker.start(placed_well(), depths_of(truth_mm), pictures)
                                                 : tracker.follow(depths_of(truth_mm), pictures);
      EXPECT_FALSE(report.lost) << report.lost_because;
    }
    return drift_mm(tracker, performance(7));
  };
  const double drift = drift_after({}, true);
  EXPECT_LT(drift, 0.4);
  EXPECT_GT(drift_after({}, false), 5 * drift) << "depth alone can't tell";
}

TEST(SkinTracker, AShadowThatStaysDoesNotHoldTheSkin) {
  const Paint faint = [](const Vector3f& at) { return 100 + 0.25F * (skin(1)(at) - 128); };
  const auto drift_after = [&](const std::vector<Lens>& projectors) {
    SkinTracker tracker(surface(), colour_lenses(), projectors, {});
    for (int slot = 0; slot < 8; ++slot) {
      const mesh::Vertices truth_mm = performance(slot);
      const auto pictures = pictures_of(truth_mm, faint, projector_light);
      const TemplateFitReport report = slot == 0 ? tracker.start(placed_well(), depths_of(truth_mm), pictures)
                                                 : tracker.follow(depths_of(truth_mm), pictures);
      EXPECT_FALSE(report.lost) << report.lost_because;
    }
    return drift_mm(tracker, performance(7));
  };
  const double drift = drift_after(projector_lenses());
  EXPECT_LT(drift, 0.8 * drift_after({})) << drift;
}

TEST(SkinTracker, FindsThePersonAgainAfterAGap) {
  SkinTracker tracker(surface(), colour_lenses(), {}, {});
  const mesh::Vertices first_mm = performance(0);
  ASSERT_FALSE(tracker.start(placed_well(), depths_of(first_mm), pictures_of(first_mm, skin(1))).lost);
  const TemplateFitReport gone = tracker.follow({}, std::vector<Frame>(2));
  EXPECT_TRUE(gone.lost);
  EXPECT_LT(drift_mm(tracker, first_mm), 0.2) << "stays what it was";

  const mesh::Vertices back_mm = performance(6).colwise() + Vector3f(15, -8, 12);
  const TemplateFitReport found =
      tracker.find_again(placed_at(back_mm), depths_of(back_mm), pictures_of(back_mm, skin(1)));
  EXPECT_FALSE(found.lost) << found.lost_because;
  EXPECT_LT(drift_mm(tracker, back_mm), 0.3);
  const mesh::Vertices next_mm = performance(7).colwise() + Vector3f(15, -8, 12);
  EXPECT_FALSE(tracker.follow(depths_of(next_mm), pictures_of(next_mm, skin(1))).lost);
  EXPECT_LT(drift_mm(tracker, next_mm), 0.3);
}

TEST(SkinTracker, SomebodyElseIsNotThePerson) {
  SkinTracker tracker(surface(), colour_lenses(), {}, {});
  const mesh::Vertices first_mm = performance(0);
  ASSERT_FALSE(tracker.start(placed_well(), depths_of(first_mm), pictures_of(first_mm, skin(1))).lost);
  const mesh::Vertices other_mm = Eigen::Vector3f(1.1F, 0.93F, 1).asDiagonal() * swollen();
  const auto pictures = pictures_of(other_mm, skin(7));
  const TemplateFitReport report = tracker.find_again(placed_at(other_mm), depths_of(other_mm), pictures);
  EXPECT_TRUE(report.lost);
  EXPECT_THAT(report.lost_because, ::testing::HasSubstr("differs"));
  EXPECT_EQ(tracker.vertices_mm().cols(), first_mm.cols());
  EXPECT_LT(drift_mm(tracker, first_mm), 0.2) << "stays what it was";
  // A new person then.
  EXPECT_FALSE(tracker.start(placed_at(other_mm), depths_of(other_mm), pictures).lost);
  EXPECT_FALSE(tracker.follow(depths_of(other_mm), pictures).lost);
}

TEST(SkinTracker, GoesOnWithThePicturesThatThereAre) {
  SkinTracker tracker(surface(), colour_lenses(), {}, {});
  for (int slot = 0; slot < 8; ++slot) {
    const mesh::Vertices truth_mm = performance(slot);
    auto pictures = pictures_of(truth_mm, skin(1));
    if (slot < 3) {
      pictures[1] = {};  // comes late
    }
    if (slot == 4) {
      pictures[0].corrupt = true;
    }
    if (slot == 5) {
      pictures.assign(2, Frame());
    }
    const TemplateFitReport report = slot == 0 ? tracker.start(placed_well(), depths_of(truth_mm), pictures)
                                               : tracker.follow(depths_of(truth_mm), pictures);
    EXPECT_FALSE(report.lost) << slot << ": " << report.lost_because;
  }
  EXPECT_LT(drift_mm(tracker, performance(7)), 1);
}

TEST(SkinTracker, GoesBetweenTwoSlotsOnDepthAlone) {
  SkinTracker tracker(surface(), colour_lenses(), {}, {});
  const mesh::Vertices before_mm = performance(0);
  const mesh::Vertices after_mm = performance(1);
  // Half way the skin bulges by 2 mm, which neither of the slots around it shows.
  mesh::Vertices truth_mm = (before_mm + after_mm) / 2;
  for (Eigen::Index v = 0; v < truth_mm.cols(); ++v) {
    const Vector3f at = surface()->neutral_mm.col(v);
    truth_mm.col(v).z() += 2 * std::exp(-(at - Vector3f(10, -10, at.z())).squaredNorm() / 600);
  }
  mesh::Vertices settled_mm;
  Eigen::VectorXd expression;
  EXPECT_FALSE(tracker.follows());
  tracker.start(placed_well(), depths_of(before_mm), pictures_of(before_mm, skin(1)));
  EXPECT_FALSE(tracker.follows()) << "there is nothing before it";
  EXPECT_THROW(tracker.between(0.5, depths_of(truth_mm), settled_mm, expression), Error);
  tracker.follow(depths_of(after_mm), pictures_of(after_mm, skin(1)));
  ASSERT_TRUE(tracker.follows());
  const mesh::Vertices now_mm = tracker.vertices_mm();
  const TemplateFitReport report = tracker.between(0.5, depths_of(truth_mm), settled_mm, expression);
  EXPECT_FALSE(report.lost) << report.lost_because;
  EXPECT_EQ(expression.size(), tracker.expression().size());
  EXPECT_EQ(tracker.vertices_mm(), now_mm) << "the slots around it stay as they were";
  const mesh::Vertices way_mm = (before_mm + after_mm) / 2;
  const render::Raycaster truth(truth_mm, surface()->triangles);
  double off = 0;
  double off_the_way = 0;
  double from_skin = 0;
  double way_from_skin = 0;
  int count = 0;
  for (Eigen::Index v = 0; v < truth_mm.cols(); ++v) {
    const Vector3f at = surface()->neutral_mm.col(v);
    if (surface()->is_skin[static_cast<std::size_t>(v)] != 0 && at.z() > 0 && at.head<2>().norm() < 35) {
      off += static_cast<double>(truth.closest_point(settled_mm.col(v), 20).distance_mm);
      off_the_way += static_cast<double>(truth.closest_point(way_mm.col(v), 20).distance_mm);
      from_skin += static_cast<double>((settled_mm.col(v) - truth_mm.col(v)).norm());
      way_from_skin += static_cast<double>((way_mm.col(v) - truth_mm.col(v)).norm());
      ++count;
    }
  }
  ASSERT_GT(count, 100);
  EXPECT_GT(off_the_way / count, 0.5);
  EXPECT_LT(off / count, 0.1);
  EXPECT_LT(from_skin, 0.8 * way_from_skin) << "along the surface nothing is known";

  // Without depth it is the way between, and says so.
  EXPECT_TRUE(tracker.between(0.25, {}, settled_mm, expression).lost);
  EXPECT_TRUE(settled_mm.isApprox(tracker.vertices_mm() / 4 + 3 * placed_well().rest.vertices_mm / 4, 1e-2F));
  EXPECT_TRUE(tracker.follow({}, pictures_of(after_mm, skin(1))).lost);
  EXPECT_FALSE(tracker.follows());
}

TEST(SkinTracker, WrongUseIsNamed) {
  SkinTracker tracker(surface(), colour_lenses(), {}, {});
  const mesh::Vertices first_mm = performance(0);
  const auto pictures = pictures_of(first_mm, skin(1));
  EXPECT_THROW(tracker.follow(depths_of(first_mm), pictures), Error);
  EXPECT_THROW(tracker.find_again(placed_well(), depths_of(first_mm), pictures), Error);
  EXPECT_THROW(tracker.start(placed_well(), depths_of(first_mm), std::vector<Frame>(1)), Error);
  // What can't be placed leaves it as it was: not started.
  EXPECT_TRUE(tracker.start(placed_well(), {}, pictures).lost);
  EXPECT_THROW(tracker.follow(depths_of(first_mm), pictures), Error);
}

}  // namespace
}  // namespace facet::fit
