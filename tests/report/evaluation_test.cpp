// The figures on surfaces whose errors are known.

#include "report/evaluation.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>

#include "facet/error.hpp"
#include "report/bands.hpp"
#include "report/take_pictures.hpp"
#include "support/mesh_frames.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;

/// A face-sized bumpy patch in front of the camera, and the same vertices to measure.
struct Patch {
  simulation::TruthMesh truth;
  Reconstruction reconstruction;
};

Patch bumpy_patch() {
  constexpr int kSide = 121;
  Patch patch;
  patch.truth.vertices_mm.resize(3, kSide * kSide);
  patch.truth.triangles.resize(3, 2 * (kSide - 1) * (kSide - 1));
  for (int row = 0; row < kSide; ++row) {
    for (int column = 0; column < kSide; ++column) {
      const float x = 1.4F * static_cast<float>(column - kSide / 2);
      const float y = 1.4F * static_cast<float>(row - kSide / 2);
      const float nose = 22 * std::exp(-(x * x + (y - 8) * (y - 8)) / 300);
      const float brow = 4 * std::exp(-(y + 30) * (y + 30) / 80) + 3 * std::sin(x / 11) * std::cos(y / 13);
      patch.truth.vertices_mm.col(row * kSide + column) =
          Vector3f(x, y, 600 + 0.006F * (x * x + 0.6F * y * y) - nose - brow);
    }
  }
  Eigen::Index next = 0;
  for (int row = 0; row + 1 < kSide; ++row) {
    for (int column = 0; column + 1 < kSide; ++column) {
      const int a = row * kSide + column;
      // Towards the camera is outside.
      patch.truth.triangles.col(next++) << a, a + kSide, a + kSide + 1;
      patch.truth.triangles.col(next++) << a, a + kSide + 1, a + 1;
    }
  }
  mesh::vertex_normals(patch.truth.vertices_mm, patch.truth.triangles, patch.truth.normals);
  patch.truth.albedo = mesh::Vertices::Constant(3, patch.truth.vertices_mm.cols(), 0.5F);
  patch.reconstruction.vertices_mm = patch.truth.vertices_mm;
  patch.reconstruction.normals = patch.truth.normals;
  for (int row = 25; row < kSide - 25; ++row) {
    for (int column = 25; column < kSide - 25; ++column) {
      patch.reconstruction.measured.push_back(row * kSide + column);
    }
  }
  return patch;
}

AccuracyFigures figures_of(const Reconstruction& reconstruction, const Truth& truth, Alignment alignment) {
  FigureSum sum;
  sum.add(0, reconstruction.measured, compare(reconstruction, truth, alignment), NAN);
  return sum.figures();
}

class Evaluation : public testing::Test {
 protected:
  Patch patch = bumpy_patch();
  Truth truth{patch.truth};
};

TEST_F(Evaluation, PerfectInputGivesNothing) {
  for (const Alignment alignment : {Alignment::None, Alignment::Rigid, Alignment::Similarity}) {
    const AccuracyFigures figures = figures_of(patch.reconstruction, truth, alignment);
    EXPECT_LT(figures.mean_mm, 0.005);
    EXPECT_LT(figures.p95_mm, 0.01);
    EXPECT_LT(figures.normal_error_deg, 0.1);
    EXPECT_TRUE(std::isnan(figures.flicker_mm));
    EXPECT_TRUE(std::isnan(figures.photometric_rms));
  }
}

TEST_F(Evaluation, AnOffsetOfOneMillimetreIsOneMillimetreUntilAligned) {
  // Along the normals, so that the nearest point is one millimetre away everywhere that is not sharply bent.
  Reconstruction inflated = patch.reconstruction;
  inflated.vertices_mm += inflated.normals;
  const AccuracyFigures figures = figures_of(inflated, truth, Alignment::None);
  EXPECT_NEAR(figures.mean_mm, 1, 0.01);
  EXPECT_NEAR(figures.median_mm, 1, 0.005);
  EXPECT_LT(figures.std_mm, 0.05);
  EXPECT_LT(figures.normal_error_deg, 0.5);

  Reconstruction shifted = patch.reconstruction;
  shifted.vertices_mm.colwise() += Vector3f(0, 0, -1);
  EXPECT_GT(figures_of(shifted, truth, Alignment::None).mean_mm, 0.7);
  EXPECT_LE(figures_of(shifted, truth, Alignment::None).p95_mm, 1.01);
  EXPECT_LT(figures_of(shifted, truth, Alignment::Rigid).mean_mm, 0.01);
  EXPECT_LT(figures_of(shifted, truth, Alignment::Similarity).mean_mm, 0.01);
}

TEST_F(Evaluation, AlignmentFindsTurnsAndScale) {
  Reconstruction moved = patch.reconstruction;
  const Eigen::Matrix3f turn =
      Eigen::AngleAxisf(0.06F, Vector3f(0.3F, 1, 0.2F).normalized()).toRotationMatrix();
  const Vector3f centre = moved.vertices_mm.rowwise().mean();
  moved.vertices_mm =
      (turn * (moved.vertices_mm.colwise() - centre)).colwise() + (centre + Vector3f(3, -2, 8));
  moved.normals = turn * moved.normals;
  EXPECT_LT(figures_of(moved, truth, Alignment::Rigid).mean_mm, 0.03);
  EXPECT_LT(figures_of(moved, truth, Alignment::Rigid).normal_error_deg, 0.3);

  // What one camera cannot know: everything larger and farther by a fifth.
  Reconstruction larger = patch.reconstruction;
  larger.vertices_mm *= 1.2F;
  EXPECT_GT(figures_of(larger, truth, Alignment::Rigid).mean_mm, 0.5);
  const Comparison comparison = compare(larger, truth, Alignment::Similarity);
  EXPECT_NEAR(comparison.truth_from_reconstruction.scale, 1 / 1.2F, 0.002F);
  EXPECT_LT(figures_of(larger, truth, Alignment::Similarity).mean_mm, 0.02);
}

TEST_F(Evaluation, AWrongFocalLengthDoesNotLeadTheAlignmentAstray) {
  // A head before a wall, met as near as a focal length that is a third short makes it: at the same pixels,
  // of which the outer ones are not its own but the wall's under the true focal length.
  constexpr float kShort = 0.68F;
  simulation::TruthMesh head = patch.truth;
  Reconstruction nearer;
  for (Eigen::Index v = 0; v < head.vertices_mm.cols(); ++v) {
    const float x = 2.2F * head.vertices_mm(0, v);
    const float y = 2.2F * head.vertices_mm(1, v);
    const float inside = 1 - (x * x / (75 * 75)) - (y * y / (105 * 105));
    const float nose = 22 * std::exp(-(x * x + (y - 8) * (y - 8)) / 300);
    head.vertices_mm.col(v) =
        Vector3f(x + 40, y + 20, inside > 0 ? 600 - 90 * std::sqrt(inside) - nose : 750);
    if (inside > 0.2F) {
      nearer.measured.push_back(static_cast<std::int32_t>(v));
    }
  }
  mesh::vertex_normals(head.vertices_mm, head.triangles, head.normals);
  nearer.vertices_mm = head.vertices_mm;
  nearer.normals = head.normals;
  nearer.vertices_mm.row(2).array() -= (1 - kShort) * 600;
  EXPECT_LT(figures_of(nearer, Truth(head), Alignment::Similarity).mean_mm, 0.03) << "neither is known";
  nearer.focal_px = kShort * 1000;
  EXPECT_LT(figures_of(nearer, Truth(head, 1000), Alignment::Similarity).mean_mm, 0.03) << "both are known";
}

TEST_F(Evaluation, SignsPointOutwards) {
  Reconstruction inflated = patch.reconstruction;
  inflated.vertices_mm += 0.5F * inflated.normals;
  for (const float distance : compare(inflated, truth, Alignment::None).signed_distance_mm) {
    EXPECT_GT(distance, 0);
  }
  inflated.vertices_mm -= 1.0F * inflated.normals;
  for (const float distance : compare(inflated, truth, Alignment::None).signed_distance_mm) {
    EXPECT_LT(distance, 0);
  }
}

TEST_F(Evaluation, NormalErrorIsTheAngle) {
  Reconstruction tilted = patch.reconstruction;
  for (Eigen::Index v = 0; v < tilted.normals.cols(); ++v) {
    const Vector3f axis = tilted.normals.col(v).unitOrthogonal();
    tilted.normals.col(v) =
        Eigen::AngleAxisf(10 * std::numbers::pi_v<float> / 180, axis) * Vector3f(tilted.normals.col(v));
  }
  EXPECT_NEAR(figures_of(tilted, truth, Alignment::None).normal_error_deg, 10, 0.1);
}

TEST_F(Evaluation, FarAwayCountsAsFarAway) {
  Reconstruction lost = patch.reconstruction;
  lost.vertices_mm.colwise() += Vector3f(0, 0, 500);
  const AccuracyFigures figures = figures_of(lost, truth, Alignment::None);
  EXPECT_EQ(figures.mean_mm, 50);
  EXPECT_EQ(figures.normal_error_deg, 180);
}

/// The patch with folds that the coarse mesh has not: furrows 5 mm apart, 0.3 mm deep, in its middle.
struct Folded {
  Reconstruction coarse;
  mesh::OneRings rings;
  std::vector<float> folds_mm;
};

Folded fold(Patch& patch) {
  Folded out{patch.reconstruction, {}, {}};
  out.rings =
      mesh::build_one_rings(patch.truth.triangles, static_cast<std::int32_t>(patch.truth.vertices_mm.cols()));
  for (Eigen::Index v = 0; v < patch.truth.vertices_mm.cols(); ++v) {
    const float x = patch.truth.vertices_mm(0, v);
    const float y = patch.truth.vertices_mm(1, v);
    const float depth_mm =
        0.3F * std::sin(2 * std::numbers::pi_v<float> * y / 8) * std::exp(-(x * x + y * y) / 400);
    out.folds_mm.push_back(depth_mm);
    patch.truth.vertices_mm.col(v) += depth_mm * patch.truth.normals.col(v);
  }
  mesh::vertex_normals(patch.truth.vertices_mm, patch.truth.triangles, patch.truth.normals);
  return out;
}

TEST_F(Evaluation, WrinklesCorrelateWhateverTheCoarseMeshIsOff) {
  const Folded folded = fold(patch);
  const Truth with_folds(patch.truth);
  Reconstruction off = folded.coarse;
  off.vertices_mm += off.normals;  // and a millimetre too far out everywhere
  const std::vector<float> true_mm = true_displacements_mm(off, {}, with_folds);
  const auto judge = [&](const std::vector<float>& recovered_mm) {
    WrinkleSum sum;
    sum.add(folded.rings, off, true_mm, recovered_mm);
    EXPECT_GT(sum.point_count(), 200U);
    EXPECT_LT(sum.point_count(), off.measured.size() / 2);
    return sum;
  };
  const WrinkleSum perfect = judge(folded.folds_mm);
  EXPECT_GT(perfect.correlation(), 0.95);
  EXPECT_NEAR(perfect.depth(), 1, 0.1);

  std::vector<float> faint = folded.folds_mm;
  std::vector<float> wrong = folded.folds_mm;
  std::vector<float> smooth = folded.folds_mm;
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  for (std::size_t v = 0; v < faint.size(); ++v) {
    const float x = patch.truth.vertices_mm(0, static_cast<Eigen::Index>(v));
    faint[v] *= 0.25F;
    faint[v] += 0.02F * x;  // what is wider than wrinkles does not count
    wrong[v] *= -1;
    smooth[v] = 0.3F * normal(random);
  }
  EXPECT_GT(judge(faint).correlation(), 0.95);
  EXPECT_NEAR(judge(faint).depth(), 0.25, 0.03);
  EXPECT_LT(judge(wrong).correlation(), -0.95);
  EXPECT_LT(std::abs(judge(smooth).correlation()), 0.2);
}

TEST_F(Evaluation, SmoothSkinHasNoWrinkles) {
  const mesh::OneRings rings =
      mesh::build_one_rings(patch.truth.triangles, static_cast<std::int32_t>(patch.truth.vertices_mm.cols()));
  const std::vector<float> none(static_cast<std::size_t>(patch.truth.vertices_mm.cols()), 0.0F);
  WrinkleSum sum;
  sum.add(rings, patch.reconstruction, true_displacements_mm(patch.reconstruction, {}, truth), none);
  EXPECT_EQ(sum.point_count(), 0U);
  EXPECT_TRUE(std::isnan(sum.correlation()));
}

TEST_F(Evaluation, FlickerIsTheTremblingNotTheBias) {
  std::mt19937 random(2);
  std::normal_distribution<float> normal;
  FigureSum steady;
  FigureSum trembling;
  FigureSum gaps;
  for (int frame = 0; frame < 12; ++frame) {
    Reconstruction mesh = patch.reconstruction;
    mesh.vertices_mm +=
        (0.4F + 0.05F * static_cast<float>(frame)) * mesh.normals;  // a bias that drifts evenly
    const Comparison biased = compare(mesh, truth, Alignment::None);
    steady.add(frame, mesh.measured, biased, 0.03);
    gaps.add(2 * frame, mesh.measured, biased, NAN);
    Comparison noisy = biased;
    for (float& distance : noisy.signed_distance_mm) {
      distance += 0.1F * normal(random);
    }
    trembling.add(frame, mesh.measured, noisy, 0.03);
  }
  EXPECT_LT(steady.figures().flicker_mm, 0.005);
  EXPECT_NEAR(trembling.figures().flicker_mm, 0.1, 0.005);
  EXPECT_TRUE(std::isnan(gaps.figures().flicker_mm));
  EXPECT_NEAR(steady.figures().photometric_rms, 0.03, 1e-9);
}

TEST(FigureSum, PercentilesAndMomentsOfKnownValues) {
  FigureSum sum;
  std::vector<std::int32_t> vertices;
  Comparison comparison;
  for (int k = 0; k < 1000; ++k) {
    vertices.push_back(k);
    comparison.signed_distance_mm.push_back((k % 2 == 0 ? 1.0F : -1.0F) * 0.01F *
                                            (static_cast<float>(k) + 0.5F));
    comparison.normal_error_deg.push_back(4);
  }
  sum.add(0, vertices, comparison, NAN);
  const AccuracyFigures figures = sum.figures();
  EXPECT_NEAR(figures.mean_mm, 5, 1e-4);
  EXPECT_NEAR(figures.std_mm, 10 / std::sqrt(12.0), 1e-3);
  EXPECT_NEAR(figures.median_mm, 5, 0.01);
  EXPECT_NEAR(figures.p95_mm, 9.5, 0.01);
  EXPECT_NEAR(figures.normal_error_deg, 4, 1e-6);
  EXPECT_EQ(sum.point_count(), 1000U);
}

TEST(FigureSum, NothingGivesNoFigures) {
  const FigureSum sum;
  EXPECT_TRUE(std::isnan(sum.figures().mean_mm));
}

TEST(MeasuredVertices, AreRefinableFacingAndSeen) {
  const auto subject = std::make_shared<mesh::Subject>(*test::patch_subject());
  const mesh::MeshFrame frame = test::patch_frame(4, subject, nullptr);
  const FrameGeometry geometry = geometry_of(frame);
  const auto all = measured_vertices(*subject, geometry.coarse_mm, geometry.coarse_normals);
  EXPECT_GT(all.size(), static_cast<std::size_t>(geometry.coarse_mm.cols()) / 3);
  EXPECT_TRUE(std::is_sorted(all.begin(), all.end()));
  for (const std::int32_t vertex : all) {
    const Vector3f at = geometry.coarse_mm.col(vertex);
    EXPECT_GT(-at.normalized().dot(geometry.coarse_normals.col(vertex)), 0.25F);
  }
  std::fill(subject->regions.begin(), subject->regions.end(), std::uint8_t{0});
  EXPECT_TRUE(measured_vertices(*subject, geometry.coarse_mm, geometry.coarse_normals).empty());
  subject->regions.clear();  // a take may do without them
  EXPECT_THROW(measured_vertices(*subject, geometry.coarse_mm, geometry.coarse_normals), Error);
}

TEST(Photometric, ZeroWhereTheImageIsTheRendering) {
  const auto subject = test::patch_subject();
  const mesh::MeshFrame frame = test::patch_frame(4, subject, test::patch_albedo(*subject));
  const FrameGeometry geometry = geometry_of(frame);
  const auto& albedo = frame.albedo->linear_rgb;
  const std::array<float, 9> lighting{0.7F, 0.1F, 0.2F, 0.1F, 0, 0, 0, 0, 0};
  // An even image, and the albedo that shows it under this light.
  const float grey = render::srgb8_to_linear(120);
  const Frame image = render::to_frame(render::plain_picture(1280, 720, {120, 120, 120}));
  std::vector<float> matching(albedo.size());
  for (Eigen::Index v = 0; v < geometry.coarse_mm.cols(); ++v) {
    const float light = render::irradiance(lighting, geometry.coarse_normals.col(v));
    std::fill_n(matching.begin() + 3 * v, 3, grey / light);
  }
  std::vector<std::int32_t> vertices;
  for (std::int32_t v = 0; v < geometry.coarse_mm.cols(); ++v) {
    vertices.push_back(v);
  }
  const auto errors = [&](const std::vector<float>& with) {
    return vertex_errors(geometry.coarse_mm, geometry.coarse_normals, with, lighting, frame.camera, image);
  };
  EXPECT_LT(photometric_rms(errors(matching), vertices), 1e-5);
  for (float& value : matching) {
    value *= 1.5F;
  }
  EXPECT_NEAR(photometric_rms(errors(matching), vertices), 0.5 * static_cast<double>(grey), 1e-4);
  EXPECT_TRUE(std::isnan(photometric_rms(errors(matching), {})));
}

TEST(SpreadEvenly, TakesTheEndsAndNoMoreThanThereAre) {
  std::vector<std::int64_t> indices;
  for (std::int64_t k = 0; k < 100; ++k) {
    indices.push_back(k);
  }
  EXPECT_EQ(spread_evenly(indices, 4), (std::vector<std::int64_t>{0, 33, 66, 99}));
  EXPECT_EQ(spread_evenly({1, 2}, 4), (std::vector<std::int64_t>{1, 2}));
  EXPECT_EQ(spread_evenly(indices, 1), (std::vector<std::int64_t>{50}));
}

}  // namespace
}  // namespace facet::report
