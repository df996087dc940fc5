#include "simulation/actor_sequence.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>

#include "camera/factory.hpp"
#include "facet/error.hpp"
#include "landmark/landmarker.hpp"
#include "simulation/sequence.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

ActorSequenceConfig small() {
  ActorSequenceConfig config;
  config.seed = 5;
  config.width_px = 321;
  config.height_px = 241;
  config.frame_count = 3;
  config.sensor_noise = false;
  return config;
}

/// Projection in front of the camera, px.
Eigen::Vector2f project(const CameraIntrinsics& camera, const Eigen::Vector3f& at_mm) {
  return {camera.fx * at_mm.x() / at_mm.z() + camera.cx, camera.fy * at_mm.y() / at_mm.z() + camera.cy};
}

TEST(ActorSequence, PictureIsTheTruthUnderTheShadingModel) {
  const ActorSequence sequence(model(), small());
  TruthMesh truth;
  const SyntheticFrame frame = sequence.render(2, &truth);
  const render::Raycaster caster(truth.vertices_mm, truth.triangles);
  const render::HitImage hits = caster.cast(sequence.camera());
  std::vector<float> errors;
  for (std::size_t pixel = 0; pixel < hits.triangle.size(); ++pixel) {
    if (hits.triangle[pixel] < 0) {
      continue;
    }
    const auto at = [&](const mesh::Vertices& field) {
      return render::interpolate(truth.triangles, hits.triangle[pixel], hits.barycentric[pixel], field);
    };
    const Eigen::Vector3f normal = at(truth.normals).normalized();
    if (-normal.z() < 0.5F) {
      continue;
    }
    const Eigen::Vector3f expected =
        render::irradiance(sequence.lighting().spherical_harmonics, normal) * at(truth.albedo);
    for (std::size_t channel = 0; channel < 3; ++channel) {
      errors.push_back(std::abs(render::srgb8_to_linear(frame.picture.rgb[3 * pixel + channel]) -
                                expected[static_cast<Eigen::Index>(channel)]));
    }
  }
  ASSERT_GT(errors.size(), 10'000U);
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.006F);  // blur and rounding; props in front of the face are few
  EXPECT_LT(errors[errors.size() * 9 / 10], 0.04F);
}

TEST(ActorSequence, FurtherCamerasSeeTheSameFaceFromTheirCalibratedPlaces) {
  ActorSequenceConfig config = small();
  const auto alone = ActorSequence(model(), config).render(2, nullptr).picture.rgb;
  config.camera_count = 3;
  const ActorSequence sequence(model(), config);
  TruthMesh truth;
  const SyntheticFrame frame = sequence.render(2, &truth);
  EXPECT_EQ(frame.picture.rgb, alone);
  ASSERT_EQ(frame.further_pictures.size(), 2U);
  ASSERT_EQ(sequence.rig().cameras.size(), 3U);
  EXPECT_TRUE(sequence.rig().cameras.front().lens.camera_from_rig.matrix().isIdentity(0));
  for (std::size_t k = 1; k < 3; ++k) {
    const capture::Lens& lens = sequence.rig().cameras[k].lens;
    const Eigen::Isometry3f view = lens.camera_from_rig.cast<float>();
    const float turn_deg = Eigen::AngleAxisf(view.linear()).angle() * 180 / std::numbers::pi_v<float>;
    EXPECT_NEAR(turn_deg, 25, 3);
    const render::Raycaster caster(view * truth.vertices_mm, truth.triangles);
    const CameraIntrinsics pinhole{static_cast<float>(lens.fx_px),
                                   static_cast<float>(lens.fy_px),
                                   static_cast<float>(lens.cx_px),
                                   static_cast<float>(lens.cy_px),
                                   lens.width_px,
                                   lens.height_px};
    const render::HitImage hits = caster.cast(pinhole);
    // What the picture shows over what the truth does: the camera's exposure, the same everywhere.
    std::array<std::vector<float>, 3> ratios;
    for (std::size_t pixel = 0; pixel < hits.triangle.size(); ++pixel) {
      if (hits.triangle[pixel] < 0) {
        continue;
      }
      const auto at = [&](const mesh::Vertices& field) {
        return render::interpolate(truth.triangles, hits.triangle[pixel], hits.barycentric[pixel], field);
      };
      const Eigen::Vector3f normal = at(truth.normals).normalized();
      const Eigen::Vector3f expected =
          render::irradiance(sequence.lighting().spherical_harmonics, normal) * at(truth.albedo);
      if (-(view.linear() * normal).z() < 0.5F || expected.minCoeff() < 0.1F) {
        continue;
      }
      for (std::size_t channel = 0; channel < 3; ++channel) {
        ratios.at(channel).push_back(
            render::srgb8_to_linear(frame.further_pictures[k - 1].rgb[3 * pixel + channel]) /
            expected[static_cast<Eigen::Index>(channel)]);
      }
    }
    for (std::vector<float>& ratio : ratios) {
      ASSERT_GT(ratio.size(), 2'000U);
      std::sort(ratio.begin(), ratio.end());
      const float gain = ratio[ratio.size() / 2];
      EXPECT_GT(gain, 0.6F);
      EXPECT_LT(gain, 1.2F);
      EXPECT_LT(ratio[ratio.size() * 3 / 4] - ratio[ratio.size() / 4], 0.06F * gain);
    }
  }
}

TEST(ActorSequence, FaceIsInThePictureAtTheRightSizeAndDistance) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    ActorSequenceConfig config = small();
    config.seed = seed;
    const ActorSequence sequence(model(), config);
    const SyntheticFrame frame = sequence.render(0, nullptr);
    const float distance_mm = frame.camera_from_head.translation().z();
    EXPECT_GT(distance_mm, 430);
    EXPECT_LT(distance_mm, 800);
    const auto landmark = [&](std::size_t index) {
      mesh::Vertices vertices_mm;
      model().evaluate(sequence.identity(), frame.expression, vertices_mm);
      return project(sequence.camera(), frame.camera_from_head * face::FaceModel::anchor_point(
                                                                     model().landmarks[index], vertices_mm));
    };
    const float height_px = (landmark(10) - landmark(152)).norm();
    EXPECT_GT(height_px, 0.3F * 241);
    EXPECT_LT(height_px, 0.65F * 241);
    EXPECT_LT((landmark(1) - Eigen::Vector2f(160, 120)).norm(), 60);
    EXPECT_GT(landmark(152).y(), landmark(10).y());  // upright
    EXPECT_GT(landmark(263).x(), landmark(33).x());  // the subject's left on the right of the picture
  }
}

TEST(ActorSequence, FramesDoNotDependOnOrder) {
  ActorSequenceConfig config = small();
  config.sensor_noise = true;
  const ActorSequence sequence(model(), config);
  const auto second = sequence.render(1, nullptr).picture.rgb;
  sequence.render(0, nullptr);
  EXPECT_EQ(sequence.render(1, nullptr).picture.rgb, second);
  EXPECT_NE(sequence.render(2, nullptr).picture.rgb, second);
}

TEST(ActorSequence, SensorNoiseIsThatOfASmallCamera) {
  ActorSequenceConfig config = small();
  const auto clean = ActorSequence(model(), config).render(1, nullptr).picture.rgb;
  config.sensor_noise = true;
  const auto noisy = ActorSequence(model(), config).render(1, nullptr).picture.rgb;
  double squares = 0;
  for (std::size_t k = 0; k < clean.size(); ++k) {
    const double difference = static_cast<double>(noisy[k]) - clean[k];
    squares += difference * difference;
  }
  const double rms = std::sqrt(squares / static_cast<double>(clean.size()));
  EXPECT_GT(rms, 0.7);
  EXPECT_LT(rms, 6);
}

TEST(ActorSequence, AreaLightShadesAndHighlightsShine) {
  ActorSequenceConfig config = small();
  config.light = LightKind::Area;
  const auto matt = ActorSequence(model(), config).render(0, nullptr).picture.rgb;
  config.highlights = true;
  const auto shiny = ActorSequence(model(), config).render(0, nullptr).picture.rgb;
  std::size_t brighter = 0;
  std::size_t darker = 0;
  for (std::size_t k = 0; k < matt.size(); ++k) {
    brighter += shiny[k] > matt[k] + 8 ? 1 : 0;
    darker += shiny[k] + 8 < matt[k] ? 1 : 0;
  }
  EXPECT_GT(brighter, 300U);
  EXPECT_EQ(darker, 0U);
  EXPECT_NE(matt, ActorSequence(model(), small()).render(0, nullptr).picture.rgb);
}

TEST(ActorSequence, RefusesConfigurationsWithoutSense) {
  for (const auto& change : std::initializer_list<void (*)(ActorSequenceConfig&)>{
           [](ActorSequenceConfig& config) { config.width_px = 0; },
           [](ActorSequenceConfig& config) { config.height_px = 100'000; },
           [](ActorSequenceConfig& config) { config.frame_count = 0; },
           [](ActorSequenceConfig& config) { config.rate_hz = 0; }}) {
    ActorSequenceConfig config = small();
    change(config);
    try {
      const ActorSequence sequence(model(), config);
      FAIL() << "accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
    }
  }
}

TEST(ActorSequence, ThePersonStaysInAnotherPerformance) {
  ActorSequenceConfig config = small();
  const ActorSequence one(model(), config);
  config.seed = 6;
  EXPECT_NE(ActorSequence(model(), config).neutral().vertices_mm, one.neutral().vertices_mm);
  config.person = 5;
  const ActorSequence other(model(), config);
  EXPECT_EQ(other.neutral().vertices_mm, one.neutral().vertices_mm);
  EXPECT_EQ(other.neutral().albedo, one.neutral().albedo);
  EXPECT_NE(other.camera().fx, one.camera().fx);
  EXPECT_NE(other.lighting().spherical_harmonics, one.lighting().spherical_harmonics);
}

TEST(Sequence, WritesEveryNthTruthAndTheHeadAtRest) {
  const test::TemporaryFolder folder;
  ActorSequenceConfig config = small();
  config.rays_per_pixel = 1;
  config.outside_span_mm = 0;
  const ActorSequence sequence(model(), config);
  EXPECT_EQ(sequence.outside_span_rms_mm(), 0);
  write_sequence(sequence, folder.path(), {.truth_every = 2, .with_surfaces = true}, [](int) {});
  EXPECT_TRUE(std::filesystem::exists(truth_file(folder.path(), 0)));
  EXPECT_FALSE(std::filesystem::exists(truth_file(folder.path(), 1)));
  EXPECT_TRUE(std::filesystem::exists(truth_file(folder.path(), 2)));
  const TruthMesh neutral = read_truth_ply(folder.path() / "truth" / "neutral.ply");
  const TruthMesh frame = read_truth_ply(truth_file(folder.path(), 0));
  EXPECT_EQ(neutral.triangles, frame.triangles);
  EXPECT_GT(neutral.vertices_mm.row(1).maxCoeff(), 50);  // upright, in the head's frame
  EXPECT_LT(neutral.vertices_mm.rowwise().mean().norm(), 100);
  // Other renderers get the head first, and all that is seen beside it.
  const TruthMesh surfaces = read_truth_ply(folder.path() / "surfaces" / "frame_000001.ply");
  EXPECT_GT(surfaces.triangles.cols(), frame.triangles.cols() + 100);
  TruthMesh truth;
  sequence.render(1, &truth);
  EXPECT_EQ(surfaces.vertices_mm.leftCols(truth.vertices_mm.cols()), truth.vertices_mm);
}

TEST(Sequence, WritesVideoTruthAndCamera) {
  const test::TemporaryFolder folder;
  ActorSequenceConfig config = small();
  config.frame_count = 2;
  const ActorSequence sequence(model(), config);
  int last = 0;
  write_sequence(sequence, folder.path() / "out", {}, [&](int done) { last = done; });
  EXPECT_EQ(last, 2);
  TruthMesh truth;
  const SyntheticFrame expected = sequence.render(1, &truth);
  EXPECT_EQ(read_truth_ply(truth_file(folder.path() / "out", 1)).vertices_mm, truth.vertices_mm);

  const auto camera = camera::open_camera({.kind = "file", .path = folder.path() / "out" / "video.mkv"});
  camera->start();
  Frame frame;
  for (int k = 0; k < 2; ++k) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
  }
  EXPECT_EQ(render::to_picture(frame).rgb, expected.picture.rgb);

  std::ifstream stream(folder.path() / "out" / "camera.json");
  const nlohmann::json document = nlohmann::json::parse(stream);
  EXPECT_EQ(document["width"], 321);
  EXPECT_EQ(document["fps"], 30);
  EXPECT_EQ(document["seed"], 5);
  EXPECT_FLOAT_EQ(document["fx"].get<float>(), sequence.camera().fx);
  ASSERT_EQ(document["frames"].size(), 2U);
  EXPECT_FLOAT_EQ(document["frames"][1]["camera_from_head"][2][3].get<float>(),
                  expected.camera_from_head(2, 3));
  EXPECT_EQ(document["frames"][1]["expression"].size(), sequence.expression_names().size());
  EXPECT_EQ(document["light"]["spherical_harmonics"].size(), 9U);
}

/// The built model and the landmark nets together: what the tracker will see.
TEST(BuiltActor, LooksLikeAFaceToTheLandmarkNet) {
  const auto nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
  if (!std::filesystem::exists(test::default_model()) || !std::filesystem::exists(nets)) {
    GTEST_SKIP() << "needs the built model and the landmark nets in " << test::assets();
  }
  const face::FaceModel built = face::FaceModel::load(test::default_model());
  for (const auto& [seed, light] : {std::pair{1, LightKind::SphericalHarmonics}, {2, LightKind::Area}}) {
    ActorSequenceConfig config;
    config.seed = static_cast<std::uint64_t>(seed);
    config.width_px = 640;
    config.height_px = 480;
    config.light = light;
    const ActorSequence sequence(built, config);
    landmark::Landmarker landmarker(nets);
    for (const int index : {0, 20, 45}) {
      const SyntheticFrame frame = sequence.render(index, nullptr);
      const auto& found = landmarker.process(render::to_frame(frame.picture));
      ASSERT_TRUE(found.found) << seed << ' ' << index;
      mesh::Vertices vertices_mm;
      built.evaluate(sequence.identity(), frame.expression, vertices_mm);
      std::vector<float> errors;
      for (std::size_t k = 0; k < built.landmarks.size(); ++k) {
        if (built.landmarks[k].weights[0] + built.landmarks[k].weights[1] + built.landmarks[k].weights[2] >
            0) {
          const Eigen::Vector3f at =
              frame.camera_from_head * face::FaceModel::anchor_point(built.landmarks[k], vertices_mm);
          errors.push_back((project(sequence.camera(), at) -
                            found.face.points_px.col(static_cast<Eigen::Index>(k)).head<2>())
                               .norm());
        }
      }
      ASSERT_GT(errors.size(), 400U);
      std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                       errors.end());
      // Net and actor each differ from the model by one to two millimetres; the eyes are 90 mm apart.
      EXPECT_LT(errors[errors.size() / 2], 0.06F * found.face.interocular_px) << seed << ' ' << index;
    }
  }
}

}  // namespace
}  // namespace facet::simulation
