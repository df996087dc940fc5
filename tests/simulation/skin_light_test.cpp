#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <string>

#include "facet/error.hpp"
#include "render/strand_caster.hpp"
#include "simulation/actor.hpp"
#include "simulation/actor_sequence.hpp"
#include "simulation/look_picture.hpp"
#include "simulation/look_shading.hpp"
#include "simulation/random.hpp"
#include "simulation/recorded_curves.hpp"
#include "simulation/scattering.hpp"
#include "simulation/strands.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

/// A flat square of side^2 vertices.
struct Plane {
  mesh::Vertices vertices_mm;
  mesh::Triangles triangles;
};
Plane make_plane(int side, float edge_mm) {
  Plane plane;
  plane.vertices_mm.resize(3, side * side);
  plane.triangles.resize(3, 2 * (side - 1) * (side - 1));
  Eigen::Index next = 0;
  for (int row = 0; row < side; ++row) {
    for (int column = 0; column < side; ++column) {
      const int v = row * side + column;
      plane.vertices_mm.col(v) << edge_mm * static_cast<float>(column), edge_mm * static_cast<float>(row), 0;
      if (row + 1 < side && column + 1 < side) {
        plane.triangles.col(next++) << v, v + 1, v + side;
        plane.triangles.col(next++) << v + 1, v + side + 1, v + side;
      }
    }
  }
  return plane;
}

TEST(Scattering, KeepsTheLightAndLeavesEvenLightAsItIs) {
  const Plane plane = make_plane(41, 0.5F);
  const Scattering scattering(plane.vertices_mm, plane.triangles);
  const Eigen::Index count = plane.vertices_mm.cols();
  std::vector<std::uint8_t> active(static_cast<std::size_t>(count), 1);
  for (std::size_t v = 0; v < active.size(); v += 7) {
    active[v] = v > 1000 ? 0 : 1;  // holes
  }
  Random random(3, 0);
  Eigen::Matrix3Xf light(3, count);
  for (Eigen::Index v = 0; v < count; ++v) {
    light.col(v) << random.uniform(), random.uniform(), random.uniform();
  }
  const auto sum = [&](const Eigen::Matrix3Xf& of) {
    Eigen::Vector3d total = Eigen::Vector3d::Zero();
    for (Eigen::Index v = 0; v < count; ++v) {
      if (active[static_cast<std::size_t>(v)] != 0) {
        total += (scattering.areas_mm2()[v] * of.col(v)).cast<double>();
      }
    }
    return total;
  };
  Eigen::Matrix3Xf spread = light;
  scattering.diffuse(skin_profile(), active, spread);
  for (Eigen::Index c = 0; c < 3; ++c) {
    EXPECT_NEAR(sum(spread)[c] / sum(light)[c], 1, 1e-3);
  }
  for (Eigen::Index v = 0; v < count; ++v) {
    if (active[static_cast<std::size_t>(v)] == 0) {
      EXPECT_EQ(spread.col(v), light.col(v));
    }
  }
  Eigen::Matrix3Xf even = Eigen::Vector3f(0.2F, 0.5F, 0.9F).replicate(1, count);
  const Eigen::Matrix3Xf before = even;
  scattering.diffuse(skin_profile(), active, even);
  EXPECT_LT((even - before).cwiseAbs().maxCoeff(), 2e-3F);
}

TEST(Scattering, SpreadsAPointByThePublishedWidths) {
  const int side = 101;
  const float edge_mm = 0.4F;
  const Plane plane = make_plane(side, edge_mm);
  const Scattering scattering(plane.vertices_mm, plane.triangles);
  const std::vector<std::uint8_t> active(static_cast<std::size_t>(side * side), 1);
  Eigen::Matrix3Xf light = Eigen::Matrix3Xf::Zero(3, side * side);
  const Eigen::Index middle = side / 2 * side + side / 2;
  light.col(middle).setOnes();
  scattering.diffuse(skin_profile(), active, light);
  Eigen::Vector3f expected = Eigen::Vector3f::Zero();
  for (const Bell& bell : skin_profile()) {
    expected += bell.variance_mm2 * bell.weight;
  }
  for (Eigen::Index c = 0; c < 3; ++c) {
    double moment = 0;
    double total = 0;
    for (Eigen::Index v = 0; v < light.cols(); ++v) {
      const auto away = static_cast<double>(plane.vertices_mm(0, v) - plane.vertices_mm(0, middle));
      moment += away * away * static_cast<double>(light(c, v));
      total += static_cast<double>(light(c, v));
    }
    EXPECT_NEAR(total, 1, 2e-3);
    EXPECT_NEAR(moment / static_cast<double>(expected[c]), 1, 0.06) << "channel " << c;
  }
  EXPECT_GT(expected.x(), 10 * expected.z());  // red goes farthest
}

TEST(StrandCaster, FindsStrandsAndOnlyThem) {
  render::Strands strands;
  strands.points.resize(4, 4);
  strands.points.col(0) << -10, 0, 100, 0.05F;
  strands.points.col(1) << 10, 0, 100, 0.05F;
  strands.points.col(2) << -10, 5, 60, 0.5F;
  strands.points.col(3) << 10, 5, 60, 0.5F;
  strands.segments = {0, 2};
  const render::StrandCaster caster(strands);
  const Eigen::Vector3f eye(0, 0, 0);
  const render::StrandCaster::Hit hit = caster.first_hit(eye, {0.025F, 0, 1}, 1000);
  EXPECT_EQ(hit.segment, 0);
  EXPECT_NEAR(hit.depth, 100, 0.2F);
  EXPECT_NEAR(hit.along, 0.625F, 1e-3F);
  EXPECT_EQ(caster.first_hit(eye, {0, 5.2F / 60, 1}, 1000).segment, 1);
  EXPECT_EQ(caster.first_hit(eye, {0, 0.002F, 1}, 1000).segment, -1);  // 0.2 mm beside a strand of 0.1 mm
  EXPECT_EQ(caster.first_hit(eye, {0.025F, 0, 1}, 90).segment, -1);
  EXPECT_TRUE(caster.occluded({0, 0, 50}, {0, 0, 150}));
  EXPECT_FALSE(caster.occluded({0, 0, 50}, {0, 0, 95}));
  EXPECT_EQ(render::StrandCaster(render::Strands{}).first_hit(eye, {0, 0, 1}, 1000).segment, -1);
  Eigen::Matrix4Xf moved = strands.points;
  moved.row(1).array() += 10;
  Eigen::Matrix4Xf moved_on = strands.points;
  moved_on.row(1).array() += 30;
  const render::StrandCaster moving(strands, {moved, moved_on});
  EXPECT_EQ(moving.first_hit(eye, {0, 5.0F / 100, 1}, 1000).segment, -1);
  EXPECT_EQ(moving.first_hit(eye, {0, 5.0F / 100, 1}, 1000, 0.25F).segment, 0);
  EXPECT_EQ(moving.first_hit(eye, {0, 20.0F / 100, 1}, 1000, 0.75F).segment, 0);
  EXPECT_EQ(moving.first_hit(eye, {0, 35.0F / 60, 1}, 1000, 1).segment, 1);
  EXPECT_EQ(moving.first_hit(eye, {0, 0, 1}, 1000, NAN).segment, -1);
  EXPECT_THROW(render::StrandCaster(strands, {moved.leftCols(3)}), Error);
  strands.segments.push_back(3);
  EXPECT_THROW(render::StrandCaster{strands}, Error);
  strands.segments.pop_back();
  strands.points(0, 1) = NAN;
  EXPECT_THROW(render::StrandCaster{strands}, Error);
}

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

Look third_type() {
  Look look;
  look.skin_type = 3;
  return look;
}

const VirtualActor& actor() {
  static const VirtualActor made(model(), {.seed = 3, .look = third_type()});
  return made;
}

TEST(HairStrands, AreRootedInTheSkinAndThin) {
  const HairStrands& hair = actor().hair();
  ASSERT_GT(hair.count(), 1000U);
  ASSERT_EQ(hair.first.size(), hair.count() + 1);
  EXPECT_EQ(static_cast<std::size_t>(hair.first.back()), hair.local_mm.size());
  for (std::size_t k = 0; k < hair.count(); ++k) {
    const auto first = static_cast<std::size_t>(hair.first[k]);
    ASSERT_GE(hair.first[k + 1] - hair.first[k], 2);
    EXPECT_LT(hair.local_mm[first].norm(), 6.5F);
    EXPECT_LE(hair.radius_mm[first], 0.05F);
    EXPECT_GE(hair.radius_mm[first], 0.025F);
    EXPECT_LE(hair.radius_mm[static_cast<std::size_t>(hair.first[k + 1]) - 1], hair.radius_mm[first]);
  }
  EXPECT_EQ(VirtualActor(model(), {.seed = 3, .look = without(third_type(), "strands")}).hair().count(), 0U);
}

TEST(HairStrands, MoveWithTheSkin) {
  ActorShape shape;
  actor().shape(std::vector<float>(actor().expression_names().size(), 0), {}, shape);
  const render::Strands before =
      place_strands(actor().hair(), shape.head_mm, shape.head_normals, actor().head_triangles());
  const Eigen::Isometry3f turn =
      Eigen::Translation3f(5, -20, 600) * Eigen::AngleAxisf(0.7F, Eigen::Vector3f(1, 2, 3).normalized());
  const render::Strands after = place_strands(actor().hair(), turn * shape.head_mm,
                                              turn.linear() * shape.head_normals, actor().head_triangles());
  ASSERT_EQ(after.segments, before.segments);
  const mesh::Vertices expected = turn * mesh::Vertices(before.points.topRows<3>());
  EXPECT_LT((after.points.topRows<3>() - expected).cwiseAbs().maxCoeff(), 0.02F);
}

ActorSequenceConfig small() {
  ActorSequenceConfig config;
  config.seed = 5;
  config.width_px = 240;
  config.height_px = 200;
  config.frame_count = 2;
  config.rays_per_pixel = 2;
  config.sensor_noise = false;
  config.light = LightKind::Lamps;
  config.look.skin_type = 3;
  return config;
}

double brightness(const render::Picture& picture) {
  double sum = 0;
  for (const std::uint8_t value : picture.rgb) {
    sum += static_cast<double>(render::srgb8_to_linear(value));
  }
  return sum / static_cast<double>(picture.rgb.size());
}

TEST(LookPicture, EachEffectChangesThePictureAndNoneTheTrueShape) {
  ActorSequenceConfig config = small();
  TruthMesh with;
  const render::Picture whole = ActorSequence(model(), config).render(1, &with).picture;
  EXPECT_EQ(ActorSequence(model(), config).render(1, nullptr).picture.rgb, whole.rgb);
  for (const char* effect : {"strands", "scattering", "gloss", "occlusion", "bounce"}) {
    config.look = without(small().look, effect);
    TruthMesh truth;
    const render::Picture picture = ActorSequence(model(), config).render(1, &truth).picture;
    EXPECT_EQ(truth.vertices_mm, with.vertices_mm) << effect;
    EXPECT_NE(picture.rgb, whole.rgb) << effect;
    const double change = brightness(picture) - brightness(whole);
    if (effect == std::string("gloss") || effect == std::string("bounce")) {
      EXPECT_LT(change, 0) << effect;  // light is missing
    }
    if (effect == std::string("scattering")) {
      EXPECT_NEAR(brightness(picture) / brightness(whole), 1, 0.01);  // light goes elsewhere, no more
    }
    if (effect != std::string("strands")) {
      EXPECT_EQ(truth.albedo, with.albedo) << effect;
    }
  }
}

TEST(LookPicture, AStrobesFramesDifferInLight) {
  ActorSequenceConfig config = small();
  config.light = LightKind::Strobe;
  const ActorSequence sequence(model(), config);
  const SyntheticFrame first = sequence.render(0, nullptr);
  const SyntheticFrame second = sequence.render(1, nullptr);
  EXPECT_EQ(first.lamp, 0);
  EXPECT_EQ(second.lamp, 1);
  // Lamp 0 is on the picture's left, lamp 1 on its right.
  const auto balance = [&](const render::Picture& picture) {
    double left = 0;
    double right = 0;
    for (int y = 60; y < 140; ++y) {
      for (int x = 60; x < 180; ++x) {
        const auto at = 3 * (static_cast<std::size_t>(y) * 240 + static_cast<std::size_t>(x));
        (x < 120 ? left : right) += static_cast<double>(picture.rgb[at]);
      }
    }
    return left / right;
  };
  EXPECT_GT(balance(first.picture), 1.05 * balance(second.picture));
}

/// Both eyes closed throughout.
std::shared_ptr<const RecordedCurves> closed_eyes() {
  std::string header = "Timecode,BlendShapeCount";
  std::string values;
  for (const std::string_view name : mesh::kArkitNames) {
    header += fmt::format(",{}", name);
    values += name == "EyeBlinkLeft" || name == "EyeBlinkRight" ? ",1" : ",0";
  }
  return std::make_shared<const RecordedCurves>(RecordedCurves::parse(
      fmt::format("{0}\n00:00:00:00.000,52{1}\n00:00:02:00.000,52{1}\n", header, values), "closed"));
}

TEST(LookPicture, AClosedEyeHasADarkLine) {
  if (!std::filesystem::exists(test::assets() / "default.facemodel")) {
    GTEST_SKIP() << "no default.facemodel (packaging/prepare)";
  }
  const auto people = face::FaceModel::load(test::assets() / "default.facemodel");
  ActorSequenceConfig config = small();
  config.width_px = 640;
  config.height_px = 480;
  config.light = LightKind::Ring;
  config.look = without(config.look, "makeup");
  config.curves = closed_eyes();
  const ActorSequence sequence(people, config);
  TruthMesh truth;
  const SyntheticFrame frame = sequence.render(0, &truth);
  const VirtualActor same(people, {.seed = config.seed, .look = config.look});
  const CameraIntrinsics& camera = sequence.camera();
  for (std::size_t side = 0; side < 2; ++side) {
    // Points of the upper lid, by their places at rest.
    const auto place_px = [&](const Eigen::Vector3f& at_rest) {
      Eigen::Index nearest = 0;
      (same.resting_mm().colwise() - at_rest).colwise().squaredNorm().minCoeff(&nearest);
      const Eigen::Vector3f at = truth.vertices_mm.col(nearest);
      return Eigen::Vector2f(camera.fx * at.x() / at.z() + camera.cx,
                             camera.fy * at.y() / at.z() + camera.cy);
    };
    const auto light_at = [&](int x, int y) {
      const auto at = 3 * (static_cast<std::size_t>(y) * 640 + static_cast<std::size_t>(x));
      return render::srgb8_to_linear(frame.picture.rgb[at + 1]);
    };
    const Eigen::Vector2f margin = place_px(same.anatomy().lid_upper.at(side));
    const int x = static_cast<int>(std::lround(margin.x()));
    const int y = static_cast<int>(std::lround(margin.y()));
    float line = 0;
    float lid = 0;
    for (int column = x - 4; column <= x + 4; ++column) {
      float darkest = 1;
      for (int row = y - 4; row <= y + 4; ++row) {
        darkest = std::min(darkest, light_at(column, row));
      }
      line += darkest / 9;
      lid += light_at(column, y - 10) / 9;
    }
    EXPECT_LT(line, 0.6F * lid) << "side " << side;
  }
}

}  // namespace
}  // namespace facet::simulation
