#include "simulation/virtual_booth.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <set>

#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "simulation/booth_rig.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

using capture::Shown;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

/// Without what can't be computed again in a few lines: noise, blur, room light, motion.
VirtualBoothConfig plain(BoothScene scene) {
  VirtualBoothConfig config;
  config.seed = 3;
  config.scene = scene;
  config.exposure_ms = 0;
  config.samples = 1;
  config.ambient = 0;
  config.projector_blur_px = 0;
  config.sensor_noise = false;
  return config;
}

const VirtualBooth& actor_booth() {
  static const VirtualBooth booth(&model(), plain(BoothScene::Actor));
  return booth;
}

std::size_t index_of(int x, int y) {
  return static_cast<std::size_t>(y) * 640 + static_cast<std::size_t>(x);
}

/// Linear value of a picture's green channel.
double linear(const Frame& frame, int x, int y) {
  return static_cast<double>(render::srgb8_to_linear(frame.row(y)[4 * x + 1]));
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Where a pixel's ray meets a plane, rig frame.
Vector3d on_plane(const capture::Lens& lens, const BoothTarget& plate, const Vector2d& pixel) {
  const Vector3d centre = lens.centre_mm();
  const Vector3d direction = lens.camera_from_rig.linear().transpose() * *lens.direction(pixel);
  return centre + direction * (plate.centre_mm - centre).dot(plate.normal) / direction.dot(plate.normal);
}

TEST(BoothRig, IsLaidOutAsPlanned) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const capture::Rig rig = make_booth_rig(seed);
    ASSERT_EQ(rig.cameras.size(), 6U);
    ASSERT_EQ(rig.pairs.size(), 2U);
    ASSERT_EQ(rig.projectors.size(), 2U);
    std::set<std::string> names;
    int colour = 0;
    for (const capture::RigCamera& camera : rig.cameras) {
      names.insert(camera.name);
      colour += camera.colour ? 1 : 0;
      // A face's width and height around the origin is in view.
      for (const Vector3d& corner : {Vector3d(-75, 95, 0), Vector3d(75, 95, 0), Vector3d(0, -95, 0)}) {
        const auto pixel = camera.lens.project(corner);
        ASSERT_TRUE(pixel);
        EXPECT_GT(pixel->minCoeff(), 10) << camera.name;
        EXPECT_LT(pixel->x(), 629) << camera.name;
        EXPECT_LT(pixel->y(), 469) << camera.name;
      }
    }
    EXPECT_EQ(names.size(), 6U);
    EXPECT_EQ(colour, 2);
    for (const capture::StereoPair& pair : rig.pairs) {
      // The right camera stands to the right of the left one, at about its height.
      const Vector3d right_mm =
          rig.cameras[pair.left].lens.camera_from_rig * rig.cameras[pair.right].lens.centre_mm();
      EXPECT_GT(right_mm.x(), 220);
      EXPECT_LT(right_mm.norm(), 330);
      EXPECT_LT(std::abs(right_mm.y()), 40);
      EXPECT_FALSE(rig.cameras[pair.left].colour || rig.cameras[pair.right].colour);
    }
    for (const capture::RigProjector& projector : rig.projectors) {
      const auto pixel = projector.lens.project({60, 100, 0});
      ASSERT_TRUE(pixel);
      EXPECT_TRUE(pixel->x() > 0 && pixel->x() < 1023 && pixel->y() > 0 && pixel->y() < 767);
    }
  }
}

TEST(VirtualBooth, PictureIsThePatternAtTheProjectedPoint) {
  const VirtualBoothConfig config = plain(BoothScene::Plane);
  const VirtualBooth booth(nullptr, config);
  const BoothTarget plate = *booth.target();
  const capture::Rig& rig = booth.rig();
  const BoothSlot slot = booth.slot(4);
  ASSERT_EQ(slot.shown(), (Shown{Shown::Kind::Stripes, 3}));
  std::vector<capture::GreyImage> shown;
  for (std::size_t p = 0; p < 2; ++p) {
    capture::PatternConfig patterns = config.patterns;
    patterns.width_px = rig.projectors[p].lens.width_px;
    patterns.height_px = rig.projectors[p].lens.height_px;
    shown.push_back(capture::draw_pattern(patterns, slot.shown(), p));
  }
  for (const std::size_t camera : {std::size_t{0}, std::size_t{3}}) {
    const capture::Lens& lens = rig.cameras[camera].lens;
    const auto light = [&](int x, int y) {
      const Vector3d at = on_plane(lens, plate, Vector2d(x, y));
      double sum = 0;
      for (std::size_t p = 0; p < 2; ++p) {
        const capture::Lens& projector = rig.projectors[p].lens;
        const Vector2d pixel = *projector.project(at);
        const int left = static_cast<int>(pixel.x());
        const int top = static_cast<int>(pixel.y());
        const double u = pixel.x() - left;
        const double v = pixel.y() - top;
        const auto value = [&](int dx, int dy) {
          return std::pow(shown[p].values[static_cast<std::size_t>((top + dy) * 1024 + left + dx)] / 255.0,
                          2.2);
        };
        const double pattern = (1 - v) * ((1 - u) * value(0, 0) + u * value(1, 0)) +
                               v * ((1 - u) * value(0, 1) + u * value(1, 1));
        const Vector3d to_projector = projector.centre_mm() - at;
        const double depth = (projector.camera_from_rig * at).z();
        const double reference = (projector.camera_from_rig * Vector3d::Zero()).z();
        const double off_axis = depth / to_projector.norm();
        sum +=
            pattern * plate.normal.dot(to_projector.normalized()) / off_axis * std::pow(reference / depth, 2);
      }
      const Vector3d ray = *lens.direction(Vector2d(x, y));
      return sum * std::pow(1 / ray.norm(), 4);
    };
    const Frame frame = slot.frame(camera);
    const DepthTruth truth = slot.depth(camera);
    std::vector<double> expected;
    std::vector<double> seen;
    for (int y = 100; y < 380; y += 3) {
      for (int x = 150; x < 500; ++x) {
        if (truth.depth_mm[index_of(x - 3, y)] == 0 || truth.depth_mm[index_of(x + 3, y)] == 0) {
          continue;
        }
        // Optics: 0.1, 0.8, 0.1 along rows and columns.
        double sum = 0;
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            sum += (dx == 0 ? 0.8 : 0.1) * (dy == 0 ? 0.8 : 0.1) * light(x + dx, y + dy);
          }
        }
        expected.push_back(sum);
        seen.push_back(linear(frame, x, y));
      }
    }
    ASSERT_GT(seen.size(), 10'000U);
    // The camera's gain is the only thing unknown.
    const double gain = std::inner_product(seen.begin(), seen.end(), expected.begin(), 0.0) /
                        std::inner_product(expected.begin(), expected.end(), expected.begin(), 0.0);
    double worst_levels = 0;
    double brightest = 0;
    for (std::size_t k = 0; k < seen.size(); ++k) {
      const double level = render::linear_to_srgb8(static_cast<float>(seen[k]));
      const double wanted = render::linear_to_srgb8(static_cast<float>(gain * expected[k]));
      worst_levels = std::max(worst_levels, std::abs(level - wanted));
      brightest = std::max(brightest, expected[k]);
    }
    EXPECT_LE(worst_levels, 1) << camera;
    EXPECT_GT(gain * brightest, 0.5);  // well exposed
    EXPECT_LT(gain * brightest, 1.0);
  }
}

TEST(VirtualBooth, DepthOfPlateAndBallIsTheirs) {
  const VirtualBooth plane(nullptr, plain(BoothScene::Plane));
  const VirtualBooth sphere(nullptr, plain(BoothScene::Sphere));
  const DepthTruth flat = plane.slot(0).depth(2, 3);
  const DepthTruth round = sphere.slot(0).depth(2, 3);
  int on_plate = 0;
  int on_ball = 0;
  int shared = 0;
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      if (const float depth_mm = flat.depth_mm[index_of(x, y)]; depth_mm > 0) {
        const capture::Lens& lens = plane.rig().cameras[2].lens;
        const Vector3d at = on_plane(lens, *plane.target(), Vector2d(x, y));
        ASSERT_NEAR((lens.camera_from_rig * at).z(), static_cast<double>(depth_mm), 2e-3);
        ++on_plate;
      }
      if (const float depth_mm = round.depth_mm[index_of(x, y)]; depth_mm > 0) {
        const capture::Lens& lens = sphere.rig().cameras[2].lens;
        const Vector3d at = lens.camera_from_rig.inverse() *
                            Vector3d(*lens.direction(Vector2d(x, y)) * static_cast<double>(depth_mm));
        // Facets are flat: up to 0.0012 mm inside.
        ASSERT_NEAR((at - sphere.target()->centre_mm).norm(), sphere.target()->radius_mm, 2.5e-3);
        ASSERT_EQ(round.skin[index_of(x, y)], 1);
        shared += round.shared[index_of(x, y)];
        ++on_ball;
      }
    }
  }
  EXPECT_GT(on_plate, 80'000);
  EXPECT_GT(on_ball, 25'000);
  // The other camera stands 16 degrees away: of what one sees of a ball, 1/2 + cos(16)/2 is seen by the
  // other.
  EXPECT_NEAR(shared / static_cast<double>(on_ball), 0.98, 0.015);
}

TEST(VirtualBooth, DepthReprojectsOntoTheSurface) {
  const BoothSlot slot = actor_booth().slot(200);
  const TruthMesh surface = slot.surface();
  const render::Raycaster caster(surface.vertices_mm, surface.triangles);
  for (const std::size_t camera : {std::size_t{0}, std::size_t{5}}) {
    const capture::Lens& lens = actor_booth().rig().cameras[camera].lens;
    const DepthTruth truth = slot.depth(camera);
    int skin = 0;
    for (int y = 1; y < 480; y += 4) {
      for (int x = 1; x < 640; x += 4) {
        const std::size_t pixel = index_of(x, y);
        if (truth.skin[pixel] == 0) {
          continue;
        }
        ++skin;
        const Vector3d at =
            lens.camera_from_rig.inverse() *
            Vector3d(*lens.direction(Vector2d(x, y)) * static_cast<double>(truth.depth_mm[pixel]));
        const auto closest = caster.closest_point(at.cast<float>(), 1);
        ASSERT_GE(closest.triangle, 0);
        ASSERT_LT(closest.distance_mm, 2e-3F);
      }
    }
    EXPECT_GT(skin, 1000);
  }
}

TEST(VirtualBooth, SkinIsLitByTheProjectorsThatReachIt) {
  if (!std::filesystem::exists(test::default_model())) {
    GTEST_SKIP() << test::default_model() << " is missing; the test model's face is too flat for shadows";
  }
  const face::FaceModel real = face::FaceModel::load(test::default_model());
  VirtualBoothConfig config = plain(BoothScene::Actor);
  config.head_motion = 1;
  const VirtualBooth booth(&real, config);
  const BoothSlot slot = booth.slot(280, {Shown::Kind::Blank, 0});
  const capture::Rig& rig = booth.rig();
  const TruthMesh surface = slot.surface();
  const render::Raycaster caster(surface.vertices_mm, surface.triangles);
  constexpr std::size_t kCamera = 4;
  const capture::Lens& lens = rig.cameras[kCamera].lens;
  const DepthTruth truth = slot.depth(kCamera);
  const Frame frame = slot.frame(kCamera);
  // By rays of the test's own: how many projectors a pixel's point faces and how many of them something hides
  // (-1 off the skin), and the green light of the others, but for a gain.
  std::vector<int> faced(std::size_t{640} * 480, -1);
  std::vector<int> hidden(std::size_t{640} * 480, -1);
  std::vector<double> light(std::size_t{640} * 480, 0.0);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      const std::size_t pixel = index_of(x, y);
      if (truth.skin[pixel] == 0) {
        continue;
      }
      const Vector3d ray = *lens.direction(Vector2d(x, y));
      const Vector3d at =
          lens.camera_from_rig.inverse() * Vector3d(ray * static_cast<double>(truth.depth_mm[pixel]));
      const auto closest = caster.closest_point(at.cast<float>(), 1);
      ASSERT_GE(closest.triangle, 0);
      const auto on_skin = [&](const Eigen::Matrix3Xf& field) {
        return Vector3d(render::interpolate(surface.triangles, closest.triangle, closest.barycentric, field)
                            .cast<double>());
      };
      const Vector3d normal = on_skin(surface.normals).normalized();
      faced[pixel] = 0;
      hidden[pixel] = 0;
      for (const capture::RigProjector& projector : rig.projectors) {
        const Vector3d centre = projector.lens.centre_mm();
        const double cosine = normal.dot((centre - at).normalized());
        if (cosine <= 0.1) {
          continue;
        }
        ++faced[pixel];
        if (caster.occluded(at.cast<float>(), centre.cast<float>(), 0.5F)) {
          ++hidden[pixel];
          continue;
        }
        const double depth = (projector.lens.camera_from_rig * at).z();
        const double reference = (projector.lens.camera_from_rig * Vector3d::Zero()).z();
        light[pixel] += cosine * std::pow(reference / depth, 2) * (centre - at).norm() / depth;
      }
      light[pixel] *= on_skin(surface.albedo).y() / std::pow(ray.norm(), 4);
    }
  }
  std::vector<double> gains_in_shadow;  // of one of the two
  std::vector<double> gains_in_light;
  for (int y = 2; y < 478; ++y) {
    for (int x = 2; x < 638; ++x) {
      const std::size_t pixel = index_of(x, y);
      bool even = faced[pixel] == 2 && hidden[pixel] < 2;  // and far from any shadow's edge
      for (int dy = -2; dy <= 2; ++dy) {
        for (int dx = -2; dx <= 2; ++dx) {
          even = even && faced[index_of(x + dx, y + dy)] == 2 &&
                 hidden[index_of(x + dx, y + dy)] == hidden[pixel];
        }
      }
      if (even) {
        const double gain_here = linear(frame, x, y) / light[pixel];
        if (hidden[pixel] == 1) {
          gains_in_shadow.push_back(gain_here);
        } else {
          gains_in_light.push_back(gain_here);
        }
      }
    }
  }
  ASSERT_GT(gains_in_shadow.size(), 50U);
  ASSERT_GT(gains_in_light.size(), 5000U);
  const double gain = median(gains_in_light);
  const auto part_off = [&](const std::vector<double>& gains) {
    // Optics and rounding; a shadow left out or put in would change the light by tens of per cent.
    const auto off = std::count_if(gains.begin(), gains.end(),
                                   [&](double each) { return std::abs(each / gain - 1) > 0.06; });
    return static_cast<double>(off) / static_cast<double>(gains.size());
  };
  EXPECT_LT(part_off(gains_in_shadow), 0.05);
  EXPECT_LT(part_off(gains_in_light), 0.02);
}

TEST(VirtualBooth, WhatNothingLightsIsBlack) {
  const Frame frame = actor_booth().slot(150, capture::Shown{}).frame(0);
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      ASSERT_LT(linear(frame, x, y), 0.01);
    }
  }
}

TEST(VirtualBooth, SlotsComeOutTheSameInAnyOrder) {
  VirtualBoothConfig config = plain(BoothScene::Actor);
  config.exposure_ms = 5;
  config.samples = 2;
  config.sensor_noise = true;
  const VirtualBooth one(&model(), config);
  const VirtualBooth other(&model(), config);
  const auto bytes = [](const Frame& frame) {
    return std::vector<std::uint8_t>(frame.row(0), frame.row(0) + 4 * 640 * 480);
  };
  const auto ninth = bytes(one.slot(9).frame(0));
  const auto third = bytes(one.slot(3).frame(0));
  const BoothSlot again = other.slot(3);
  again.depth(0);
  EXPECT_EQ(bytes(again.frame(0)), third);
  EXPECT_EQ(bytes(other.slot(9).frame_set().frames.front()), ninth);
  EXPECT_NE(ninth, third);
  EXPECT_EQ(one.slot(9).trigger_ns(), 150'000'000);
}

TEST(VirtualBooth, VertexDifferencesAreTheFlowOfTheSkin) {
  // Room light alone: soft, so that a point keeps its colour while it moves.
  VirtualBoothConfig config = plain(BoothScene::Actor);
  config.ambient = 1;
  config.head_motion = 1;
  const VirtualBooth booth(&model(), config);
  constexpr std::size_t kCamera = 4;
  const BoothSlot before = booth.slot(200, capture::Shown{});
  const BoothSlot after = booth.slot(209, capture::Shown{});
  const TruthMesh from = before.surface();
  const TruthMesh to = after.surface();
  ASSERT_EQ(from.triangles, to.triangles);
  ASSERT_EQ(from.vertices_mm.cols(), to.vertices_mm.cols());
  ASSERT_EQ(booth.skin().size(), from.vertices_mm.cols());
  const Frame first = before.frame(kCamera);
  const Frame second = after.frame(kCamera);
  const DepthTruth first_depth = before.depth(kCamera);
  const DepthTruth second_depth = after.depth(kCamera);
  const capture::Lens& lens = booth.rig().cameras[kCamera].lens;
  const auto sample = [](const Frame& frame, const Vector2d& at) {
    const int x = static_cast<int>(at.x());
    const int y = static_cast<int>(at.y());
    const double u = at.x() - x;
    const double v = at.y() - y;
    return (1 - v) * ((1 - u) * linear(frame, x, y) + u * linear(frame, x + 1, y)) +
           v * ((1 - u) * linear(frame, x, y + 1) + u * linear(frame, x + 1, y + 1));
  };
  // What a point of the skin shows at its two places, and at its first place in the second picture.
  struct Seen {
    bool twice = false;
    double first = 0;
    double moved = 0;
    double unmoved = 0;
  };
  std::vector<Seen> points(static_cast<std::size_t>(from.vertices_mm.cols()));
  std::vector<double> steps_px;
  for (Eigen::Index v = 0; v < from.vertices_mm.cols(); ++v) {
    const Vector3d was_mm = from.vertices_mm.col(v).cast<double>();
    const Vector3d is_mm = to.vertices_mm.col(v).cast<double>();
    const auto was = lens.project(was_mm);
    const auto is = lens.project(is_mm);
    if (booth.skin()[v] < 0.9F || !was || !is || was->minCoeff() < 2 || is->minCoeff() < 2 ||
        was->x() > 637 || is->x() > 637 || was->y() > 477 || is->y() > 477) {
      continue;
    }
    const auto visible = [&](const DepthTruth& truth, const Vector2d& at, const Vector3d& point_mm) {
      const std::size_t pixel =
          index_of(static_cast<int>(std::lround(at.x())), static_cast<int>(std::lround(at.y())));
      return std::abs(static_cast<double>(truth.depth_mm[pixel]) - (lens.camera_from_rig * point_mm).z()) < 1;
    };
    if (visible(first_depth, *was, was_mm) && visible(second_depth, *is, is_mm)) {
      points[static_cast<std::size_t>(v)] = {true, sample(first, *was), sample(second, *is),
                                             sample(second, *was)};
      steps_px.push_back((*is - *was).norm());
    }
  }
  ASSERT_GT(steps_px.size(), 3000U);
  EXPECT_GT(median(steps_px), 3);
  // Differences along edges: what the turning head changes in its shading is the same at both ends.
  double first_first = 0;
  double moved_moved = 0;
  double unmoved_unmoved = 0;
  double first_moved = 0;
  double first_unmoved = 0;
  for (Eigen::Index t = 0; t < from.triangles.cols(); ++t) {
    const Seen& a = points[static_cast<std::size_t>(from.triangles(0, t))];
    const Seen& b = points[static_cast<std::size_t>(from.triangles(1, t))];
    if (a.twice && b.twice) {
      first_first += std::pow(b.first - a.first, 2);
      moved_moved += std::pow(b.moved - a.moved, 2);
      unmoved_unmoved += std::pow(b.unmoved - a.unmoved, 2);
      first_moved += (b.first - a.first) * (b.moved - a.moved);
      first_unmoved += (b.first - a.first) * (b.unmoved - a.unmoved);
    }
  }
  EXPECT_GT(first_moved / std::sqrt(first_first * moved_moved), 0.8);
  EXPECT_LT(first_unmoved / std::sqrt(first_first * unmoved_unmoved), 0.5);
}

TEST(VirtualBooth, ExposureGathersWhatMoves) {
  VirtualBoothConfig config = plain(BoothScene::Actor);
  config.head_motion = 1;
  config.samples = 4;
  config.slots_per_second = 100;
  config.exposure_ms = 8;
  const VirtualBooth blurred(&model(), config);
  config.slots_per_second = 1000;  // a slot each millisecond, of which each is a moment
  config.exposure_ms = 0;
  const VirtualBooth sharp(&model(), config);
  const Shown stripes{Shown::Kind::Stripes, 7};
  const Frame picture = blurred.slot(310, stripes).frame(0);
  std::vector<Frame> moments;
  for (const std::uint64_t millisecond : {1U, 3U, 5U, 7U}) {
    moments.push_back(sharp.slot(3100 + millisecond, stripes).frame(0));
  }
  double against_mean = 0;
  double against_one = 0;
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      double mean = 0;
      for (const Frame& moment : moments) {
        mean += linear(moment, x, y) / 4;
      }
      against_mean += std::pow(linear(picture, x, y) - mean, 2);
      against_one += std::pow(linear(picture, x, y) - linear(moments[0], x, y), 2);
    }
  }
  EXPECT_LT(against_mean, 0.25 * against_one);
}

TEST(VirtualBooth, NoiseIsThatOfTheSensor) {
  VirtualBoothConfig config = plain(BoothScene::Plane);
  const Frame clean = VirtualBooth(nullptr, config).slot(2).frame(0);
  config.sensor_noise = true;
  const VirtualBooth noisy(nullptr, config);
  const Frame one = noisy.slot(2).frame(0);
  const Frame other = noisy.slot(5).frame(0);  // blank too, and still
  double square = 0;
  double product = 0;
  double light = 0;
  int count = 0;
  for (int y = 180; y < 300; ++y) {
    for (int x = 260; x < 380; ++x, ++count) {
      const double first = linear(one, x, y) - linear(clean, x, y);
      const double second = linear(other, x, y) - linear(clean, x, y);
      square += first * first;
      product += first * second;
      light += linear(clean, x, y);
    }
  }
  light /= count;
  const double rounding = 0.004;  // a level of 8 bits here, over the root of 12, is a quarter of it
  EXPECT_NEAR(std::sqrt(square / count), std::sqrt(light * 12'000 + 100) / 12'000, rounding / 3);
  EXPECT_LT(std::abs(product), 0.1 * square);
}

TEST(VirtualBooth, WhatMakesNoSenseIsRefused) {
  VirtualBoothConfig config = plain(BoothScene::Actor);
  EXPECT_THROW(VirtualBooth(nullptr, config), Error);
  config.scene = BoothScene::Plane;
  config.exposure_ms = 17;
  EXPECT_THROW(VirtualBooth(nullptr, config), Error);
  config.exposure_ms = 0;
  config.samples = 0;
  EXPECT_THROW(VirtualBooth(nullptr, config), Error);
  config.samples = 1;
  const VirtualBooth booth(nullptr, config);
  EXPECT_THROW(booth.slot(0).frame(6), Error);
  EXPECT_THROW(booth.slot(0).depth(0, 6), Error);
}

TEST(VirtualBooth, ProjectorsShowGivenPictures) {
  VirtualBoothConfig config = plain(BoothScene::Plane);
  config.sensor_noise = true;
  const VirtualBooth booth(nullptr, config);
  const auto drawn = [&](std::size_t projector) {
    capture::PatternConfig patterns = config.patterns;
    patterns.width_px = booth.rig().projectors[projector].lens.width_px;
    patterns.height_px = booth.rig().projectors[projector].lens.height_px;
    return capture::draw_pattern(patterns, {Shown::Kind::Stripes, 3}, projector);
  };
  const BoothSlot own = booth.slot(4, {drawn(0), drawn(1)});
  EXPECT_EQ(own.shown().kind, Shown::Kind::Picture);
  const Frame given = own.frame(0);
  const Frame program = booth.slot(4).frame(0);
  const Frame one = booth.slot(4, {drawn(0), {}}).frame(0);
  const Frame none = booth.slot(4, std::vector<capture::GreyImage>(2)).frame(0);
  const Frame dark = booth.slot(4, Shown{}).frame(0);
  double light_of_both = 0;
  double light_of_one = 0;
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      ASSERT_EQ(given.row(y)[4 * x], program.row(y)[4 * x]);
      ASSERT_EQ(none.row(y)[4 * x], dark.row(y)[4 * x]);
      light_of_both += linear(given, x, y);
      light_of_one += linear(one, x, y);
    }
  }
  EXPECT_LT(light_of_one, 0.8 * light_of_both);
  EXPECT_GT(light_of_one, 0.2 * light_of_both);
  EXPECT_THROW(booth.slot(4, std::vector<capture::GreyImage>{drawn(0)}), Error);
  capture::GreyImage small = drawn(1);
  small.height_px -= 1;
  EXPECT_THROW(booth.slot(4, {drawn(0), small}), Error);
}

TEST(VirtualBooth, AnActorHoldsThePoseOfAMoment) {
  VirtualBoothConfig config = plain(BoothScene::Actor);
  config.pose_s = 20 / config.slots_per_second;
  const VirtualBooth still(&model(), config);
  const std::vector<float> held = still.slot(3).depth(0).depth_mm;
  EXPECT_EQ(still.slot(200).depth(0).depth_mm, held);
  EXPECT_EQ(actor_booth().slot(20).depth(0).depth_mm, held);
  EXPECT_NE(actor_booth().slot(200).depth(0).depth_mm, held);
  config.pose_s = -1;
  EXPECT_THROW(VirtualBooth(&model(), config), Error);
}

TEST(VirtualBooth, TargetsStandWhereTheyAreMoved) {
  VirtualBoothConfig config = plain(BoothScene::Sphere);
  const Vector3d before = VirtualBooth(nullptr, config).target()->centre_mm;
  config.target_shift_mm = {30, -20, 10};
  const VirtualBooth moved(nullptr, config);
  EXPECT_LT((moved.target()->centre_mm - before - config.target_shift_mm).norm(), 1e-9);
  const Vector3f mean = moved.slot(0).surface().vertices_mm.rowwise().mean();
  EXPECT_LT((mean.cast<double>() - moved.target()->centre_mm).norm(), 1);
  config.target_shift_mm = {300, 0, 0};
  EXPECT_THROW(VirtualBooth(nullptr, config), Error);
}

}  // namespace
}  // namespace facet::simulation
