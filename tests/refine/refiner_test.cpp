#include "refine/refiner.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "facet/error.hpp"
#include "reference.hpp"
#include "refine/level_buffers.hpp"
#include "refine/refiner_options.hpp"
#include "support/gpu.hpp"
#include "support/synthetic_face.hpp"

namespace facet::refine {
namespace {

using RefinerTest = facet::test::GpuTest;

/// A synthetic face and a refiner that knows its smooth cap.
class Session {
 public:
  Session(gpu::Context& context, const synthetic::Scene& shown, const RefinerConfig& config,
          float min_edge_px = 4)
      : scene(shown), cap(synthetic::make_cap(shown)), refiner(context, config) {
    mesh::HierarchyOptions options;
    options.min_edge_px = min_edge_px;
    hierarchy = synthetic::hierarchy(scene, cap, options);
    std::vector<mesh::Vertices> positions;
    mesh::push_positions(*hierarchy, cap.vertices_mm, positions);
    cap_xy_mm = positions.back().topRows(2);
    refiner.set_subject({hierarchy, cap.mean_albedo, cap.control.refinable});
  }

  RefineInput input() {
    RefineInput out;
    out.image = synthetic::render(scene);
    out.camera = synthetic::camera(scene);
    out.camera_from_head = synthetic::camera_from_head(scene);
    out.control_vertices_mm = &cap.vertices_mm;
    return out;
  }

  RefineOutcome refine() {
    refiner.submit(input());
    return refiner.collect(output);
  }

  /// What a further camera shows.
  FurtherCamera view(float camera_yaw_rad, const std::array<float, 3>& exposure) const {
    synthetic::Scene there = scene;
    there.camera_yaw_rad = camera_yaw_rad;
    there.exposure = exposure;
    there.seed += 1000;
    return {synthetic::render(there), synthetic::camera(there), synthetic::view_from_reference(there)};
  }

  /// Frames with the head turning to and fro, each with noise of its own.
  void run(int frames) {
    for (int k = 0; k < frames; ++k) {
      pose(k);
      ASSERT_EQ(refine(), RefineOutcome::Refined) << output.failure;
    }
  }

  enum class First { Seen, Hidden, Gone };

  /// The same with a second camera. first: whether something stands before the first one, or it has no
  /// picture.
  void run_two(int frames, const std::array<float, 3>& exposure, First first = First::Seen) {
    for (int k = 0; k < frames; ++k) {
      pose(k);
      const FurtherCamera beside = view(beside_rad, exposure);
      RefineInput both = input();
      both.further_views = {&beside, 1};
      both.image_counts = first != First::Hidden;
      if (first == First::Gone) {
        both.image = {};
      }
      refiner.submit(both);
      ASSERT_EQ(refiner.collect(output), RefineOutcome::Refined) << output.failure;
    }
  }

  void pose(int frame) {
    scene.seed = static_cast<unsigned>(frame) + 1;
    scene.yaw_rad = turned_rad + 0.3F * std::sin(0.3F * static_cast<float>(frame));
  }

  float turned_rad = 0;      ///< the head, on average
  float beside_rad = 0.45F;  ///< of the second camera

  synthetic::Errors errors(const std::vector<float>& displacements_mm) const {
    constexpr float kMarginMm = 8;
    mesh::Vertices vertices;
    Eigen::Matrix3Xf normals;
    mesh::rebuild_finest(*hierarchy, cap.vertices_mm, displacements_mm, vertices, normals);
    return synthetic::compare(scene, vertices, normals, cap_xy_mm, kMarginMm);
  }

  synthetic::Scene scene;
  synthetic::Cap cap;
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  Eigen::Matrix2Xf cap_xy_mm;
  Refiner refiner;
  RefineOutput output;
};

synthetic::Scene small_scene() {
  synthetic::Scene scene;
  scene.image_width_px = 250;
  scene.image_height_px = 300;
  scene.quad_mm = 6;
  scene.noise = 1.5F;
  return scene;
}

/// Weights for a clean scene: a known albedo, no more than what [MD19 eq. 1] describes.
RefinerConfig clean_config() {
  RefinerConfig config;
  config.weights.displacement_smooth = 0.05F;
  config.weights.displacement_hierarchy = 0.05F;
  config.weights.displacement_coarse = 0.002F;
  return config;
}

TEST_F(RefinerTest, NormalsApproachTheTruth) {
  Session session(context(), small_scene(), clean_config());
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = 1;
  for (Eigen::Index i = 0; i < session.cap_xy_mm.cols(); ++i) {
    const Eigen::Vector3f rho =
        synthetic::albedo(session.scene, session.cap_xy_mm(0, i), session.cap_xy_mm(1, i));
    albedo->linear_rgb.insert(albedo->linear_rgb.end(), rho.data(), rho.data() + 3);
  }
  session.refiner.set_subject(
      {session.hierarchy, session.cap.mean_albedo, session.cap.control.refinable, albedo});
  session.run(25);
  const synthetic::Errors coarse = session.errors({});
  const synthetic::Errors refined = session.errors(session.output.displacements_mm);
  RecordProperty("coarse_deg", std::to_string(coarse.normal_deg));
  RecordProperty("refined_deg", std::to_string(refined.normal_deg));
  EXPECT_LT(refined.normal_deg, 0.8 * coarse.normal_deg) << coarse.normal_deg;
  EXPECT_LT(refined.distance_mm, coarse.distance_mm);
  EXPECT_EQ(session.output.albedo, albedo);
  // 1.5 counts of noise and what the smoothness takes away.
  EXPECT_LT(session.output.photometric_rms, 0.012F);
}

TEST_F(RefinerTest, ACameraThatShowsNothingChangesNothing) {
  Session one(context(), small_scene(), clean_config());
  Session two(context(), small_scene(), clean_config());
  for (int k = 0; k < 3; ++k) {
    one.pose(k);
    two.pose(k);
    ASSERT_EQ(one.refine(), RefineOutcome::Refined);
    FurtherCamera nothing = two.view(two.beside_rad, {1, 1, 1});
    nothing.image = {};
    RefineInput input = two.input();
    input.further_views = {&nothing, 1};
    two.refiner.submit(input);
    ASSERT_EQ(two.refiner.collect(two.output), RefineOutcome::Refined);
    ASSERT_EQ(two.output.displacements_mm, one.output.displacements_mm) << k;
    ASSERT_EQ(two.output.confidence, one.output.confidence) << k;
    ASSERT_EQ(two.output.lighting, one.output.lighting) << k;
  }
}

TEST_F(RefinerTest, TwoCamerasComeNearerToTheTruthThanOne) {
  // The head looks at the second camera; the first one sees it at a slant.
  const auto turn = [](Session& session) { session.turned_rad = session.beside_rad = 1.0F; };
  Session one(context(), small_scene(), clean_config());
  turn(one);
  one.run(12);
  Session two(context(), small_scene(), clean_config());
  turn(two);
  two.run_two(12, {1, 1, 1});
  const double coarse_deg = one.errors({}).normal_deg;
  const double one_deg = one.errors(one.output.displacements_mm).normal_deg;
  const double two_deg = two.errors(two.output.displacements_mm).normal_deg;
  EXPECT_LT(one_deg, coarse_deg);
  EXPECT_LT(two_deg, 0.98 * one_deg);
  EXPECT_TRUE(std::all_of(two.output.confidence.begin(), two.output.confidence.end(),
                          [](float c) { return c >= 0 && c <= 1; }));

  // Another exposure and white balance of the second camera is found, and changes hardly anything.
  Session darker(context(), small_scene(), clean_config());
  turn(darker);
  darker.run_two(12, {0.62F, 0.55F, 0.5F});
  EXPECT_NEAR(darker.errors(darker.output.displacements_mm).normal_deg, two_deg, 0.03 * two_deg);
  EXPECT_NEAR(darker.output.lighting[0], two.output.lighting[0], 0.02F * two.output.lighting[0]);
}

TEST_F(RefinerTest, TheSecondCameraAloneIsEnough) {
  Session session(context(), small_scene(), {});
  session.run_two(12, {0.8F, 0.8F, 0.8F}, Session::First::Hidden);
  EXPECT_LT(session.errors(session.output.displacements_mm).normal_deg, session.errors({}).normal_deg);

  // From the first frame on the first camera has no picture, not even one to look away from.
  Session gone(context(), small_scene(), {});
  gone.run_two(12, {0.8F, 0.8F, 0.8F}, Session::First::Gone);
  EXPECT_EQ(gone.output.displacements_mm, session.output.displacements_mm);
  EXPECT_EQ(gone.output.confidence, session.output.confidence);
}

TEST_F(RefinerTest, OutputsFitTheSubject) {
  Session session(context(), small_scene(), {});
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  const auto count = static_cast<std::size_t>(session.hierarchy->finest().vertex_count);
  EXPECT_EQ(session.output.displacements_mm.size(), count);
  EXPECT_EQ(session.output.confidence.size(), count);
  EXPECT_TRUE(std::all_of(session.output.confidence.begin(), session.output.confidence.end(),
                          [](float c) { return c >= 0 && c <= 1; }));
  ASSERT_NE(session.output.albedo, nullptr);
  EXPECT_EQ(session.output.albedo->linear_rgb.size(), 3 * count);
  EXPECT_TRUE(session.output.failure.empty());
  EXPECT_TRUE(session.output.energies.empty());
  const mesh::OneRings& rings = session.hierarchy->finest().one_rings;
  for (std::size_t v = 0; v < count; ++v) {
    if (rings.on_boundary[v] != 0) {
      EXPECT_EQ(session.output.displacements_mm[v], 0);
    }
  }
}

TEST_F(RefinerTest, NoTimeLeftInterpolatesAllButTheCoarsestLevel) {
  Session session(context(), small_scene(), clean_config());
  ASSERT_GE(session.hierarchy->levels.size(), 2U);
  RefineInput hurried = session.input();
  hurried.time_limit_ms = 0.01F;
  for (int k = 0; k < 6; ++k) {
    session.refiner.submit(hurried);
    ASSERT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined) << session.output.failure;
  }
  const RefineOutput& output = session.output;
  EXPECT_EQ(output.steps.front(), 1);
  EXPECT_EQ(std::count(output.steps.begin() + 1, output.steps.end(), 0),
            static_cast<std::ptrdiff_t>(output.steps.size()) - 1);
  EXPECT_NE(output.given_up, "");
  // A free vertex of the finest level stands where the coarser one's displacements put it.
  const auto free = free_vertices(*session.hierarchy, session.cap.control.refinable);
  const mesh::SparseRows& rows = session.hierarchy->finest().from_coarser;
  std::size_t compared = 0;
  for (std::size_t v = 0; v < free.back().size(); ++v) {
    const auto first = static_cast<std::size_t>(rows.row_offsets[v]);
    const auto end = static_cast<std::size_t>(rows.row_offsets[v + 1]);
    // The coarser level's vertices keep their numbers: those that the finest level did not move show them.
    if (end - first == 1 || free.back()[v] == 0) {
      continue;
    }
    float low = std::numeric_limits<float>::max();
    float high = std::numeric_limits<float>::lowest();
    for (std::size_t entry = first; entry < end; ++entry) {
      const float d = output.displacements_mm[static_cast<std::size_t>(rows.columns[entry])];
      low = std::min(low, d);
      high = std::max(high, d);
    }
    constexpr float kVertexMaskMoves_mm = 0.5F;  // corners are averaged with their neighbours
    EXPECT_GE(output.displacements_mm[v], low - kVertexMaskMoves_mm);
    EXPECT_LE(output.displacements_mm[v], high + kVertexMaskMoves_mm);
    ++compared;
  }
  EXPECT_GT(compared, 500U);
  EXPECT_TRUE(std::any_of(output.displacements_mm.begin(), output.displacements_mm.end(),
                          [](float d) { return std::abs(d) > 0.05F; }));
  // Time enough: the same subject is refined on every level again.
  for (int k = 0; k < 2; ++k) {
    ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  }
  EXPECT_EQ(std::count(session.output.steps.begin(), session.output.steps.end(), 0), 0);
  EXPECT_EQ(session.output.given_up, "");
}

TEST_F(RefinerTest, WhatShadesUntrustedSkinIsNoShape) {
  Session session(context(), small_scene(), clean_config());
  std::vector<float> trust;
  for (const float x_mm : session.cap.vertices_mm.row(0)) {
    trust.push_back(x_mm < 0 ? 0.0F : 1.0F);
  }
  session.refiner.set_subject({.hierarchy = session.hierarchy,
                               .mean_albedo = session.cap.mean_albedo,
                               .refinable = session.cap.control.refinable,
                               .trust = trust});
  session.run(8);
  constexpr float kAway_mm = 20;  // what smoothness carries over the border ends before
  double untrusted = 0;
  double trusted = 0;
  int confident = 0;
  for (Eigen::Index v = 0; v < session.cap_xy_mm.cols(); ++v) {
    const auto at = static_cast<std::size_t>(v);
    const double d = session.output.displacements_mm[at];
    if (session.cap_xy_mm(0, v) < -kAway_mm) {
      untrusted += d * d;
      EXPECT_EQ(session.output.confidence[at], 0);
    } else if (session.cap_xy_mm(0, v) > kAway_mm) {
      trusted += d * d;
      confident += session.output.confidence[at] > 0 ? 1 : 0;
    }
  }
  EXPECT_LT(untrusted, 0.1 * trusted);
  EXPECT_GT(confident, 500);
  trust.pop_back();
  EXPECT_THROW(session.refiner.set_subject({.hierarchy = session.hierarchy,
                                            .mean_albedo = session.cap.mean_albedo,
                                            .refinable = session.cap.control.refinable,
                                            .trust = trust}),
               Error);
}

TEST_F(RefinerTest, AutoComesToTheEnergyOfManySteps) {
  const auto last_energies = [&](Budget budget) {
    RefinerConfig config = clean_config();
    config.budget = budget;
    config.record_energies = true;
    Session session(context(), small_scene(), config);
    session.run(25);
    std::vector<double> out;
    for (const auto& level : session.output.energies) {
      out.push_back(level.back());
    }
    return out;
  };
  const std::vector<double> paper = last_energies(Budget::Paper);
  const std::vector<double> quick = last_energies(Budget::Auto);
  ASSERT_EQ(paper.size(), quick.size());
  for (std::size_t l = 0; l < paper.size(); ++l) {
    EXPECT_NEAR(quick[l] / paper[l], 1, 0.02) << "level " << l;
  }
}

TEST_F(RefinerTest, AlbedoIsTheSameObjectOnceLearned) {
  RefinerConfig config;
  config.albedo_frames = 4;
  Session session(context(), small_scene(), config);
  // Vertices that are seen at a slant weigh less and learn longer.
  for (int k = 0; k < 48; ++k) {
    ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  }
  const auto learned = session.output.albedo;
  for (int k = 0; k < 12; ++k) {
    ASSERT_EQ(session.refine(), RefineOutcome::Refined);
    EXPECT_EQ(session.output.albedo, learned);
  }
  EXPECT_GE(learned->version, 4U);
}

TEST_F(RefinerTest, EnergiesFallWithEveryStep) {
  RefinerConfig config;
  config.record_energies = true;
  config.budget = Budget::Fixed;
  config.gauss_newton_steps = 4;
  config.robust_scale = 0;
  Session session(context(), small_scene(), config);
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  ASSERT_EQ(session.output.energies.size(), session.hierarchy->levels.size());
  for (const std::vector<double>& level : session.output.energies) {
    ASSERT_EQ(level.size(), 5U);
    EXPECT_LT(level.back(), level.front());
    for (std::size_t step = 1; step < level.size(); ++step) {
      // Without a line search a step near the minimum may overshoot by a little.
      EXPECT_LT(level[step], 1.001 * level[step - 1]);
    }
  }
}

TEST_F(RefinerTest, ExcludedPartsStayAsTheyAre) {
  Session session(context(), small_scene(), {});
  SubjectSetup subject{session.hierarchy, session.cap.mean_albedo, session.cap.control.refinable};
  for (Eigen::Index i = 0; i < session.cap.vertices_mm.cols(); ++i) {
    subject.refinable[static_cast<std::size_t>(i)] = session.cap.vertices_mm(1, i) < 0 ? 1 : 0;
  }
  session.refiner.set_subject(subject);
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  float largest_above = 0;
  float largest_below = 0;
  for (Eigen::Index i = 0; i < session.cap_xy_mm.cols(); ++i) {
    const float d = std::abs(session.output.displacements_mm[static_cast<std::size_t>(i)]);
    const float y = session.cap_xy_mm(1, i);
    if (y > session.scene.quad_mm) {
      largest_above = std::max(largest_above, d);
    } else if (y < -session.scene.quad_mm) {
      largest_below = std::max(largest_below, d);
    }
  }
  EXPECT_EQ(largest_above, 0);
  EXPECT_GT(largest_below, 0.1F);
}

TEST_F(RefinerTest, PhotometricErrorAndConfidenceAreThoseOfTheOutput) {
  // In an image of one colour every vertex sees that colour, so the outputs alone tell the residuals.
  RefinerConfig config;
  config.robust_scale = 0.8F;
  Session session(context(), small_scene(), config);
  RefineInput input = session.input();
  auto grey = std::make_shared<std::uint8_t[]>(input.image.stride_bytes *
                                               static_cast<std::size_t>(input.image.height_px));
  std::memset(grey.get(), 128, input.image.stride_bytes * static_cast<std::size_t>(input.image.height_px));
  input.image.pixels = grey;
  session.refiner.submit(input);
  ASSERT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined);

  constexpr double kGrey = 0.21586;  // sRGB 128
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*session.hierarchy, session.cap.vertices_mm, session.output.displacements_mm, vertices,
                       normals);
  const Eigen::Matrix3f camera_from_head = input.camera_from_head.linear();
  double squares = 0;
  double count = 0;
  for (Eigen::Index i = 0; i < normals.cols(); ++i) {
    const auto v = static_cast<std::size_t>(i);
    if (session.output.confidence[v] <= 0) {
      continue;
    }
    const Eigen::Vector3f n = camera_from_head * normals.col(i);
    const float shade = synthetic::shade(session.output.lighting, {n.x(), -n.y(), -n.z()});
    for (std::size_t c = 0; c < 3; ++c) {
      const double r = kGrey - static_cast<double>(shade * session.output.albedo->linear_rgb[3 * v + c]);
      squares += r * r;
    }
    count += 1;
  }
  ASSERT_GT(count, 500);
  const double expected = std::sqrt(squares / (3 * count));
  // Half precision colours: one part in 1024 of the grey.
  EXPECT_NEAR(static_cast<double>(session.output.photometric_rms), expected, 3e-4);
}

/// A mesh of the person's own shape is held to more than a guess is.
TEST_F(RefinerTest, AKnownShapeIsMovedLess) {
  std::vector<double> moved;
  for (const bool known : {false, true}) {
    Session session(context(), small_scene(), {});
    session.refiner.set_subject({.hierarchy = session.hierarchy,
                                 .mean_albedo = session.cap.mean_albedo,
                                 .refinable = session.cap.control.refinable,
                                 .known_shape = known});
    session.run(5);
    const Eigen::Map<const Eigen::VectorXf> displacements(
        session.output.displacements_mm.data(),
        static_cast<Eigen::Index>(session.output.displacements_mm.size()));
    moved.push_back(displacements.cwiseAbs().cast<double>().mean());
  }
  EXPECT_GT(moved[0], 0.02);
  EXPECT_LT(moved[1], 0.8 * moved[0]);
}

/// True displacement of every vertex, as if an enrolment had found it.
std::vector<float> true_relief_mm(const Session& session) {
  std::vector<float> out;
  for (Eigen::Index i = 0; i < session.cap_xy_mm.cols(); ++i) {
    out.push_back(
        synthetic::displacement_mm(session.scene, session.cap_xy_mm(0, i), session.cap_xy_mm(1, i)));
  }
  return out;
}

TEST_F(RefinerTest, AKnownReliefIsThereBeforeAnyPictureSaysSo) {
  Session session(context(), small_scene(), {});
  ASSERT_GT(session.hierarchy->levels.size(), 1U);
  const std::vector<float> relief_mm = true_relief_mm(session);
  session.refiner.set_subject({.hierarchy = session.hierarchy,
                               .mean_albedo = session.cap.mean_albedo,
                               .refinable = session.cap.control.refinable,
                               .relief_mm = relief_mm});
  RefineInput input = session.input();
  input.camera_from_head.pretranslate(Eigen::Vector3f(5000, 0, 0));
  session.refiner.submit(input);
  ASSERT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined) << session.output.failure;
  const std::vector<std::uint8_t> free =
      free_vertices(*session.hierarchy, session.cap.control.refinable).back();
  float largest = 0;
  for (std::size_t v = 0; v < free.size(); ++v) {
    const float expected = free[v] != 0 ? relief_mm[v] : 0;
    ASSERT_NEAR(session.output.displacements_mm[v], expected, 1e-4F) << "vertex " << v;
    largest = std::max(largest, std::abs(expected));
  }
  EXPECT_GT(largest, 0.2F);
}

TEST_F(RefinerTest, AKnownReliefBringsTheMeshNearer) {
  std::vector<synthetic::Errors> errors;
  for (const bool known : {false, true}) {
    Session session(context(), small_scene(), {});
    session.refiner.set_subject({.hierarchy = session.hierarchy,
                                 .mean_albedo = session.cap.mean_albedo,
                                 .refinable = session.cap.control.refinable,
                                 .known_shape = true,
                                 .relief_mm = known ? true_relief_mm(session) : std::vector<float>()});
    session.run(5);
    errors.push_back(session.errors(session.output.displacements_mm));
  }
  EXPECT_LT(errors[1].normal_deg, 0.5 * errors[0].normal_deg);
  EXPECT_LT(errors[1].distance_mm, 0.5 * errors[0].distance_mm);
}

/// True albedo of every vertex under a light of another colour, as if an enrolment had found it.
mesh::Vertices true_albedo(const Session& session, const Eigen::Array3f& hue) {
  mesh::Vertices out(3, session.cap_xy_mm.cols());
  for (Eigen::Index i = 0; i < out.cols(); ++i) {
    out.col(i) =
        hue * synthetic::albedo(session.scene, session.cap_xy_mm(0, i), session.cap_xy_mm(1, i)).array();
  }
  return out;
}

/// A skin that is known brings its tone along and is handed out with its moles; in which light it was met
/// before does not count.
TEST_F(RefinerTest, AKnownSkinIsHandedOutInItsOwnDetail) {
  synthetic::Scene marked = small_scene();
  marked.marks = true;
  std::vector<synthetic::Errors> errors;
  std::vector<double> albedo_off;
  std::vector<Eigen::ArrayXf> hues;  // against the session's true one
  for (const bool known : {false, true}) {
    Session session(context(), marked, {});
    const mesh::Vertices skin = true_albedo(session, {1.3F, 1, 0.8F});
    session.refiner.set_subject({.hierarchy = session.hierarchy,
                                 .mean_albedo = session.cap.mean_albedo,
                                 .refinable = session.cap.control.refinable,
                                 .known_shape = true,
                                 .skin_albedo = known ? skin : mesh::Vertices()});
    session.run(8);
    errors.push_back(session.errors(session.output.displacements_mm));
    const Eigen::Map<const mesh::Vertices> found(session.output.albedo->linear_rgb.data(), 3, skin.cols());
    const Eigen::ArrayXXf ratio = found.array() / true_albedo(session, {1, 1, 1}).array();
    const Eigen::ArrayXf usual = ratio.rowwise().mean();
    hues.push_back(usual / usual.mean());
    albedo_off.push_back(static_cast<double>((ratio.colwise() / usual - 1).abs().mean()));
  }
  EXPECT_LT((hues[1] - hues[0]).abs().maxCoeff(), 0.03F) << "1.3, 1, 0.8 is another session's";
  // Of a tone that the frames teach as well the normals gain nothing.
  EXPECT_LT(errors[1].normal_deg, 1.05 * errors[0].normal_deg);
  EXPECT_LT(albedo_off[1], 0.5 * albedo_off[0]);
}

TEST_F(RefinerTest, GivenDisplacementsHoldAgainstTheShadingByTheirWeight) {
  constexpr float kGiven_mm = 0.7F;
  constexpr float kOneLevel_px = 1e6F;
  std::vector<float> moved;
  for (const float weight : {0.0F, 1.0F, 1e5F}) {
    RefinerConfig config = clean_config();
    config.given_prior = true;
    config.weights.displacement_coarse = 0;
    config.weights.displacement_hierarchy = weight;
    Session session(context(), small_scene(), config, kOneLevel_px);
    ASSERT_EQ(session.hierarchy->levels.size(), 1U);
    std::vector<std::uint8_t> refinable = session.cap.control.refinable;
    std::fill(refinable.begin(), refinable.begin() + static_cast<std::ptrdiff_t>(refinable.size() / 4), 0);
    session.refiner.set_subject({session.hierarchy, session.cap.mean_albedo, refinable});
    const std::vector<float> given(static_cast<std::size_t>(session.cap.vertices_mm.cols()), kGiven_mm);
    RefineInput input = session.input();
    input.prior_displacements_mm = given;
    for (int k = 0; k < 3; ++k) {
      session.refiner.submit(input);
      ASSERT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined) << session.output.failure;
    }
    const std::vector<std::uint8_t> free = free_vertices(*session.hierarchy, refinable).front();
    float sum = 0;
    for (std::size_t v = 0; v < free.size(); ++v) {
      if (free[v] == 0) {
        ASSERT_NEAR(session.output.displacements_mm[v], kGiven_mm, 1e-5F) << "shading does not move it";
      }
      sum += std::abs(session.output.displacements_mm[v] - kGiven_mm);
    }
    moved.push_back(sum / static_cast<float>(free.size()));
  }
  EXPECT_GT(moved[0], 2 * moved[1]);
  EXPECT_GT(moved[1], 100 * moved[2]);
  EXPECT_LT(moved[2], 1e-3F);
}

TEST_F(RefinerTest, ImageSizeMayChange) {
  Session session(context(), small_scene(), {});
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  session.scene.image_width_px = 131;
  session.scene.image_height_px = 157;
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  session.scene.image_width_px = 16;
  session.scene.image_height_px = 16;
  ASSERT_EQ(session.refine(), RefineOutcome::Refined) << session.output.failure;
}

TEST_F(RefinerTest, AFaceOutOfTheImageIsLeftCoarse) {
  Session session(context(), small_scene(), {});
  RefineInput input = session.input();
  input.camera_from_head.pretranslate(Eigen::Vector3f(5000, 0, 0));
  session.refiner.submit(input);
  ASSERT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined) << session.output.failure;
  for (std::size_t v = 0; v < session.output.displacements_mm.size(); ++v) {
    EXPECT_EQ(session.output.displacements_mm[v], 0);
    EXPECT_EQ(session.output.confidence[v], 0);
  }
  // Behind the camera, too.
  input.camera_from_head.pretranslate(Eigen::Vector3f(-5000, 0, -2000));
  session.refiner.submit(input);
  EXPECT_EQ(session.refiner.collect(session.output), RefineOutcome::Refined) << session.output.failure;
}

TEST_F(RefinerTest, NumericalFailureGivesTheCoarseMeshAndPasses) {
  Session session(context(), small_scene(), {});
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  mesh::Vertices broken = session.cap.vertices_mm;
  broken.col(broken.cols() / 2).setConstant(std::numeric_limits<float>::quiet_NaN());
  RefineInput input = session.input();
  input.control_vertices_mm = &broken;
  session.refiner.submit(input);
  EXPECT_EQ(session.refiner.collect(session.output), RefineOutcome::NumericalFailure);
  EXPECT_FALSE(session.output.failure.empty());
  EXPECT_EQ(session.output.displacements_mm.size(),
            static_cast<std::size_t>(session.hierarchy->finest().vertex_count));
  EXPECT_TRUE(std::all_of(session.output.displacements_mm.begin(), session.output.displacements_mm.end(),
                          [](float d) { return d == 0; }));
  session.run(3);
  EXPECT_LT(session.errors(session.output.displacements_mm).normal_deg, session.errors({}).normal_deg);
}

TEST_F(RefinerTest, ALostDeviceIsReported) {
  Session session(context(), small_scene(), {});
  ASSERT_EQ(session.refine(), RefineOutcome::Refined);
  context().simulate_loss();
  session.refiner.submit(session.input());
  EXPECT_EQ(session.refiner.collect(session.output), RefineOutcome::DeviceLost);
  EXPECT_TRUE(session.output.displacements_mm.empty());
  EXPECT_FALSE(session.output.failure.empty());
}

TEST_F(RefinerTest, MisuseIsRefused) {
  RefinerConfig no_steps;
  no_steps.gauss_newton_steps = 0;
  EXPECT_THROW(Refiner(context(), no_steps), Error);
  Refiner bare(context(), {});
  EXPECT_THROW(bare.submit({}), Error);
  EXPECT_THROW(bare.set_subject({}), Error);
  RefineOutput output;
  EXPECT_EQ(bare.collect(output), RefineOutcome::NumericalFailure);
  EXPECT_FALSE(output.failure.empty());

  Session session(context(), small_scene(), {});
  RefineInput input = session.input();
  mesh::Vertices few = session.cap.vertices_mm.leftCols(7);
  input.control_vertices_mm = &few;
  EXPECT_THROW(session.refiner.submit(input), Error);
  input = session.input();
  input.image = {};
  EXPECT_THROW(session.refiner.submit(input), Error);
  input = session.input();
  const std::vector<float> unasked(static_cast<std::size_t>(session.cap.vertices_mm.cols()));
  input.prior_displacements_mm = unasked;
  EXPECT_THROW(session.refiner.submit(input), Error);
  input = session.input();
  FurtherCamera larger = session.view(0, {1, 1, 1});
  larger.camera.width_px += 1;
  input.further_views = {&larger, 1};
  EXPECT_THROW(session.refiner.submit(input), Error);
  SubjectSetup subject{session.hierarchy, session.cap.mean_albedo, {1, 1, 1}};
  EXPECT_THROW(session.refiner.set_subject(subject), Error);
  subject.refinable = session.cap.control.refinable;
  subject.relief_mm = {0.5F};
  EXPECT_THROW(session.refiner.set_subject(subject), Error);
}

TEST(WeightsFor, WhatIsKnownBeforehandHasAWeightOfItsOwn) {
  const Weights usual;
  const auto differing = [&](const SubjectSetup& subject) {
    const Weights weights = weights_for(subject, usual);
    return std::array{weights.albedo_smooth / usual.albedo_smooth,
                      weights.displacement_smooth / usual.displacement_smooth,
                      weights.displacement_coarse / usual.displacement_coarse};
  };
  const float skin = usual.albedo_smooth_known / usual.albedo_smooth;
  const float relief = usual.displacement_smooth_known / usual.displacement_smooth;
  const float shape = usual.displacement_coarse_known / usual.displacement_coarse;
  EXPECT_EQ(differing(SubjectSetup()), (std::array{1.0F, 1.0F, 1.0F}));
  SubjectSetup subject;
  subject.skin_albedo = mesh::Vertices::Zero(3, 2);
  EXPECT_EQ(differing(subject), (std::array{skin, 1.0F, 1.0F}));
  subject.relief_mm = {0, 0};
  EXPECT_EQ(differing(subject), (std::array{skin, relief, 1.0F}));
  subject.known_shape = true;
  EXPECT_EQ(differing(subject), (std::array{skin, relief, shape}));
}

}  // namespace
}  // namespace facet::refine
