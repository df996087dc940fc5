// Skin points that slide by a known way, bands of known width, walks over a surface.

#include "report/skin_points.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "report/bands.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;

/// A wavy sheet of `side` by `side` vertices `spacing_mm` apart, 600 mm away, towards the camera.
struct Sheet {
  simulation::TruthMesh truth;
  Reconstruction mesh;
};

Sheet sheet(int side, float spacing_mm) {
  Sheet out;
  out.truth.vertices_mm.resize(3, Eigen::Index{side} * side);
  out.truth.triangles.resize(3, Eigen::Index{2} * (side - 1) * (side - 1));
  Eigen::Index next = 0;
  for (int row = 0; row < side; ++row) {
    for (int column = 0; column < side; ++column) {
      const float x = spacing_mm * static_cast<float>(column - side / 2);
      const float y = spacing_mm * static_cast<float>(row - side / 2);
      const int a = row * side + column;
      out.truth.vertices_mm.col(a) << x, y, 600 + 2 * std::sin(x / 9) * std::cos(y / 7);
      if (row + 1 < side && column + 1 < side) {
        out.truth.triangles.col(next++) << a, a + side, a + side + 1;
        out.truth.triangles.col(next++) << a, a + side + 1, a + 1;
      }
      const int margin = side / 5;
      if (std::min({row, column, side - 1 - row, side - 1 - column}) >= margin) {
        out.mesh.measured.push_back(a);
      }
    }
  }
  mesh::vertex_normals(out.truth.vertices_mm, out.truth.triangles, out.truth.normals);
  out.truth.albedo = mesh::Vertices::Constant(3, out.truth.vertices_mm.cols(), 0.5F);
  out.mesh.vertices_mm = out.truth.vertices_mm;
  out.mesh.normals = out.truth.normals;
  return out;
}

TEST(SkinPoints, SlidingSkinIsSeenThoughTheSurfaceStaysClose) {
  Sheet at_first = sheet(61, 1);
  SkinPointSum sum;
  constexpr int kFrames = 21;
  double told_mm = 0;
  for (int frame = 0; frame < kFrames; ++frame) {
    // The truth's skin slides under the mesh along its own surface by a tenth of a millimetre a frame.
    simulation::TruthMesh moved = at_first.truth;
    for (Eigen::Index v = 0; v < moved.vertices_mm.cols(); ++v) {
      const float x = moved.vertices_mm(0, v) + 0.1F * static_cast<float>(frame);
      const float y = moved.vertices_mm(1, v);
      moved.vertices_mm.col(v) << x, y, 600 + 2 * std::sin(x / 9) * std::cos(y / 7);
    }
    mesh::vertex_normals(moved.vertices_mm, moved.triangles, moved.normals);
    const Truth truth(moved);
    const Comparison comparison = measure(at_first.mesh, truth, {});
    for (const float distance : comparison.signed_distance_mm) {
      EXPECT_LT(std::abs(distance), 0.05F);
    }
    sum.add(7, 0.5 * frame, at_first.mesh, comparison, truth.mesh(),
            [&](std::int32_t, double mm) { told_mm += mm; });
  }
  const SkinPointFigures figures = sum.figures();
  EXPECT_TRUE(sum.missing().empty());
  EXPECT_EQ(figures.points, (kFrames - 1) * at_first.mesh.measured.size());
  EXPECT_NEAR(told_mm / static_cast<double>(figures.points), figures.mean_mm, 1e-6);
  EXPECT_NEAR(figures.mean_mm, 1.05, 0.03);  // 0.1 to 2 mm, and a little more up and down
  EXPECT_NEAR(figures.tangential_mm, figures.mean_mm, 0.02);
  EXPECT_NEAR(figures.first_fifth_mm, 0.25, 0.02);
  EXPECT_NEAR(figures.last_fifth_mm, 1.85, 0.05);
  EXPECT_NEAR(figures.drift_mm(), 1.6, 0.05);
  EXPECT_NEAR(figures.slope_mm_per_10_s, 2, 0.05);
  EXPECT_NEAR(figures.p95_mm, 2, 0.1);
}

TEST(SkinPoints, AnotherSubjectIsPinnedAnewAndAnotherTopologyEndsIt) {
  const Sheet one = sheet(31, 2);
  const Truth truth(one.truth);
  const Comparison comparison = measure(one.mesh, truth, {});
  SkinPointSum sum;
  EXPECT_FALSE(sum.missing().empty());
  sum.add(1, 0, one.mesh, comparison, truth.mesh());
  EXPECT_FALSE(sum.missing().empty());
  EXPECT_TRUE(std::isnan(sum.figures().mean_mm));
  sum.add(2, 1, one.mesh, comparison, truth.mesh());
  EXPECT_EQ(sum.figures().points, 0U);
  sum.add(2, 2, one.mesh, comparison, truth.mesh());
  EXPECT_EQ(sum.figures().points, one.mesh.measured.size());
  EXPECT_LT(sum.figures().mean_mm, 1e-3);
  EXPECT_TRUE(std::isnan(sum.figures().first_fifth_mm));  // of one frame there are no fifths
  simulation::TruthMesh other = one.truth;
  other.triangles.col(0).swap(other.triangles.col(1));
  EXPECT_FALSE(sum.has_topology_of(other));
  sum.add(2, 3, one.mesh, comparison, other);
  EXPECT_NE(sum.missing().find("triangles change"), std::string::npos);
  EXPECT_TRUE(std::isnan(sum.figures().mean_mm));
}

TEST(RingSmoother, IsTheRepeatedHalfRingAverage) {
  const Sheet one = sheet(24, 1);
  const mesh::OneRings rings =
      mesh::build_one_rings(one.truth.triangles, static_cast<std::int32_t>(one.truth.vertices_mm.cols()));
  const std::vector<std::int32_t>& vertices = one.mesh.measured;
  std::mt19937 random(3);
  std::normal_distribution<float> normal;
  Eigen::Matrix2Xf fields(2, static_cast<Eigen::Index>(vertices.size()));
  for (float& value : fields.reshaped()) {
    value = normal(random);
  }
  for (const int rounds : {0, 1, 2, 7, 60}) {
    // The plain way, round by round over all vertices; those that do not count have no weight.
    std::vector<Eigen::Vector2f> plain(static_cast<std::size_t>(one.truth.vertices_mm.cols()), {0, 0});
    std::vector<float> weight(plain.size(), 0);
    for (std::size_t k = 0; k < vertices.size(); ++k) {
      plain[static_cast<std::size_t>(vertices[k])] = fields.col(static_cast<Eigen::Index>(k));
      weight[static_cast<std::size_t>(vertices[k])] = 1;
    }
    for (int round = 0; round < rounds; ++round) {
      auto next = plain;
      for (const std::int32_t vertex : vertices) {
        const auto v = static_cast<std::size_t>(vertex);
        Eigen::Vector2f sum(0, 0);
        float total = 0;
        for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
          const auto j = static_cast<std::size_t>(rings.neighbours[static_cast<std::size_t>(k)]);
          sum += weight[j] * plain[j];
          total += weight[j];
        }
        next[v] = 0.5F * plain[v] + 0.5F * sum / total;
      }
      plain = next;
    }
    Eigen::Matrix2Xf smoothed = fields;
    RingSmoother(rings, vertices).smooth(smoothed, rounds);
    for (std::size_t k = 0; k < vertices.size(); ++k) {
      EXPECT_LT(
          (smoothed.col(static_cast<Eigen::Index>(k)) - plain[static_cast<std::size_t>(vertices[k])]).norm(),
          2e-4F)
          << rounds;
    }
  }
}

TEST(Bands, EachWidthIsInItsOwnBand) {
  const Sheet one = sheet(161, 0.8F);
  const mesh::OneRings rings =
      mesh::build_one_rings(one.truth.triangles, static_cast<std::int32_t>(one.truth.vertices_mm.cols()));
  const auto waves = [&](float length_mm, float height_mm) {
    std::vector<float> field;
    for (Eigen::Index v = 0; v < one.truth.vertices_mm.cols(); ++v) {
      field.push_back(height_mm *
                      std::sin(2 * std::numbers::pi_v<float> * one.truth.vertices_mm(0, v) / length_mm));
    }
    return field;
  };
  const auto sums = [&](const std::vector<float>& truth, const std::vector<float>& recovered) {
    const BandFields bands = split_bands(rings, one.mesh, truth, recovered);
    std::array<FieldSum, 3> out;
    out[0].add(bands.whole.true_mm, bands.whole.recovered_mm);
    out[1].add(bands.middle.true_mm, bands.middle.recovered_mm);
    out[2].add(bands.wrinkles.true_mm, bands.wrinkles.recovered_mm);
    return out;
  };
  // Folds of 8 mm pass the band of wrinkles, forms of 40 mm the one of 4 to 15 mm; each recovered by half.
  const auto folds = sums(waves(8, 0.4F), waves(8, 0.2F));
  EXPECT_NEAR(folds[0].depth(), 0.5, 1e-4);
  EXPECT_NEAR(folds[2].depth(), 0.5, 1e-3);
  EXPECT_NEAR(folds[2].correlation(), 1, 1e-3);
  EXPECT_GT(folds[2].true_rms(), 0.2);
  EXPECT_NEAR(folds[2].error_rms(), folds[2].true_rms() / 2, 1e-3);
  EXPECT_LT(folds[1].true_rms(), 0.03);
  const auto forms = sums(waves(40, 0.4F), waves(40, 0.2F));
  EXPECT_GT(forms[1].true_rms(), 0.12);
  EXPECT_NEAR(forms[1].depth(), 0.5, 1e-2);
  EXPECT_LT(forms[2].point_count(), folds[2].point_count() / 10);
  // What is wider than both is in the whole alone.
  const auto slopes = sums(waves(400, 0.4F), waves(400, 0.2F));
  EXPECT_LT(slopes[1].true_rms(), 0.25 * slopes[0].true_rms());
  EXPECT_EQ(slopes[2].point_count(), 0U);
  EXPECT_TRUE(std::isnan(slopes[2].correlation()));
}

TEST(Truth, WalksToTheNearestPoint) {
  const Sheet one = sheet(61, 1);
  const Truth truth(one.truth);
  std::mt19937 random(11);
  std::uniform_real_distribution<float> near(-1.5F, 1.5F);
  for (const std::int32_t vertex : one.mesh.measured) {
    const Vector3f before = one.truth.vertices_mm.col(vertex) + Vector3f(near(random), near(random), 1);
    const Vector3f after = before + Vector3f(near(random), near(random), near(random));
    const auto from = truth.caster().closest_point(before, 50);
    const auto exact = truth.caster().closest_point(after, 50);
    EXPECT_NEAR(truth.closest_from(from.triangle, after).distance_mm, exact.distance_mm, 1e-3F);
  }
}

TEST(Measure, AgainIsTheSameUnderAnotherAlignment) {
  Sheet one = sheet(61, 1);
  const Truth truth(one.truth);
  one.mesh.vertices_mm += 0.7F * one.mesh.normals;
  const Comparison first = measure(one.mesh, truth, {});
  maths::Similarity other;
  other.scale = 1.002F;
  other.translation_mm = {0.4F, -0.3F, 0.2F};
  const Comparison exact = measure(one.mesh, truth, other);
  const Comparison near = measure(one.mesh, truth, other, &first);
  const Comparison again = measure_again(one.mesh, truth, other, first);
  for (std::size_t k = 0; k < exact.triangle.size(); ++k) {
    EXPECT_NEAR(near.signed_distance_mm[k], exact.signed_distance_mm[k], 1e-3F);
    EXPECT_NEAR(again.signed_distance_mm[k], exact.signed_distance_mm[k], 1e-3F);
  }
}

TEST(AlignTogether, FindsOneSimilarityForAllFrames) {
  Sheet one = sheet(121, 1.4F);
  Sheet two = one;
  for (Sheet* each : {&one, &two}) {
    // Frames whose own depth errors cancel each other; what they share is a scale of 5 %.
    const float shift_mm = each == &one ? 1.5F : -1.5F;
    for (Eigen::Index v = 0; v < each->truth.vertices_mm.cols(); ++v) {
      const float x = each->truth.vertices_mm(0, v);
      const float y = each->truth.vertices_mm(1, v);
      each->truth.vertices_mm(2, v) -= 25 * std::exp(-(x * x + y * y) / 500);
    }
    mesh::vertex_normals(each->truth.vertices_mm, each->truth.triangles, each->truth.normals);
    each->mesh.vertices_mm = each->truth.vertices_mm * 1.05F;
    each->mesh.vertices_mm.row(2).array() += shift_mm;
    each->mesh.normals = each->truth.normals;
  }
  const Truth first(one.truth);
  const Truth second(two.truth);
  const maths::Similarity both =
      align_together({{&one.mesh, &first}, {&two.mesh, &second}}, Alignment::Similarity);
  const auto mean_of = [](const Comparison& comparison) {
    double sum = 0;
    for (const float distance : comparison.signed_distance_mm) {
      sum += static_cast<double>(distance);
    }
    return sum / static_cast<double>(comparison.signed_distance_mm.size());
  };
  EXPECT_LT(both.scale, 0.99F);
  EXPECT_NEAR(mean_of(measure(one.mesh, first, both)), -1.4, 0.2);  // farther away than the truth: inside
  EXPECT_NEAR(mean_of(measure(two.mesh, second, both)), 1.4, 0.2);
  EXPECT_NEAR(mean_of(compare(one.mesh, first, Alignment::Similarity)), 0, 0.05);
  EXPECT_EQ(align_together({{&one.mesh, &first}}, Alignment::None).scale, 1);
  maths::Similarity start;
  start.scale = 1 / 1.05F;
  EXPECT_NEAR(mean_of(measure(one.mesh, first, align_from({&one.mesh, &first}, Alignment::Rigid, start))), 0,
              0.05);
}

}  // namespace
}  // namespace facet::report
