#include "person/skin_relief.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <random>

#include "actors_turn.hpp"
#include "facet/assets.hpp"
#include "person/relief_solve.hpp"
#include "person/surface_anchor.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {
namespace {

constexpr int kSide = 49;
constexpr double kTexelMm = 0.5;
constexpr double kBumpMm = 0.4;

/// A flat patch of skin with a bump or without one, under a lamp that stands elsewhere in every picture.
class PatchTest : public ::testing::Test {
 protected:
  PatchTest() : grid_(kSide, kSide, std::vector<char>(std::size_t{kSide} * kSide, 1)) {}

  /// Beside the patch's middle, so that nothing is symmetric.
  static double bump_mm(Eigen::Index texel) {
    const double x = (static_cast<double>(texel % kSide) - 20) * kTexelMm;
    const Eigen::Index row = texel / kSide;
    const double y = (static_cast<double>(row) - 27) * kTexelMm;
    return kBumpMm * std::exp(-(x * x + y * y) / (2 * 1.5 * 1.5));
  }

  /// Freckles: an albedo that no relief explains.
  static float albedo(Eigen::Index texel) {
    return 0.4F + (texel % 7 == 3 && (texel / kSide) % 5 == 2
                       ? -0.2F
                       : 0.05F * std::sin(0.3F * static_cast<float>(texel % kSide)));
  }

  /// Pictures of a relief, brightness by exact normals.
  ShadedPictures pictures_of(const Eigen::VectorXd& relief_mm) const {
    const std::array<Eigen::Vector3d, 6> lamps{
        Eigen::Vector3d(0.6, 0, 0.8),  Eigen::Vector3d(-0.6, 0, 0.8),    Eigen::Vector3d(0, 0.6, 0.8),
        Eigen::Vector3d(0, -0.6, 0.8), Eigen::Vector3d(0.4, 0.4, 0.825), Eigen::Vector3d(0, 0, 1)};
    const auto count = static_cast<Eigen::Index>(lamps.size());
    ShadedPictures pictures;
    pictures.weight = Eigen::MatrixXf::Ones(count, grid_.count());
    pictures.brightness = pictures.shading = pictures.slope_u = pictures.slope_v = pictures.weight;
    for (Eigen::Index i = 0; i < grid_.count(); ++i) {
      const bool right = (i + 1) % kSide != 0;
      const bool below = i + kSide < grid_.count();
      const double u = right ? (relief_mm[i + 1] - relief_mm[i]) / kTexelMm : 0;
      const double v = below ? (relief_mm[i + kSide] - relief_mm[i]) / kTexelMm : 0;
      const Eigen::Vector3d normal = Eigen::Vector3d(-u, -v, 1).normalized();
      for (Eigen::Index k = 0; k < count; ++k) {
        const Eigen::Vector3d& lamp = lamps[static_cast<std::size_t>(k)];
        pictures.brightness(k, i) = albedo(i) * static_cast<float>(lamp.dot(normal));
        pictures.shading(k, i) = static_cast<float>(lamp.z());
        pictures.slope_u(k, i) = static_cast<float>(-lamp.x() / kTexelMm);
        pictures.slope_v(k, i) = static_cast<float>(-lamp.y() / kTexelMm);
      }
    }
    return pictures;
  }

  AlbedoPrior prior() const { return {Eigen::ArrayXf::Constant(grid_.count(), 0.4F), 0.02F, 0.3F}; }

  /// The relief that is found of pictures of a relief.
  Eigen::VectorXd found(const Eigen::VectorXd& relief_mm) const {
    const ShadedPictures pictures = pictures_of(relief_mm);
    const ReliefPrior weak{kTexelMm, 1e-3, 1e-4, 1e-5};
    Eigen::VectorXd out = Eigen::VectorXd::Zero(grid_.count());
    for (int step = 0; step < 3; ++step) {
      out += relief_step(grid_, slope_system(grid_, pictures, prior(), out, 0.5F), weak, out);
    }
    return out;
  }

  Eigen::VectorXd bump() const {
    Eigen::VectorXd out(grid_.count());
    for (Eigen::Index i = 0; i < out.size(); ++i) {
      out[i] = bump_mm(i);
    }
    return out;
  }

  TexelGrid grid_;
};

TEST_F(PatchTest, ABumpIsFoundWithItsSignAndHeight) {
  for (const double sign : {1.0, -1.0}) {
    const Eigen::VectorXd truth = sign * bump();
    Eigen::VectorXd off = found(truth) - truth;
    off.array() -= off.mean();
    EXPECT_LT(off.norm(), 0.15 * bump().norm()) << sign;
  }
}

TEST_F(PatchTest, HalvesAgreeOnABumpAndNotOnNoise) {
  const std::array<char, 6> halves{0, 1, 1, 0, 0, 1};
  const ReliefPrior usual{kTexelMm};
  EXPECT_GT(agreement_of_halves(grid_, pictures_of(bump()), prior(), usual, halves, 0.5F), 0.8);
  ShadedPictures noise = pictures_of(Eigen::VectorXd::Zero(grid_.count()));
  std::mt19937 random(5);
  std::normal_distribution<float> grain(0, 0.02F);
  for (float& value : noise.brightness.reshaped()) {
    value += grain(random);
  }
  EXPECT_LT(agreement_of_halves(grid_, noise, prior(), usual, halves, 0.5F), 0.3);
}

/// What a relief shades is no albedo once the relief is known.
TEST_F(PatchTest, TheAlbedoIsFreeOfAKnownRelief) {
  ShadedPictures pictures = pictures_of(bump());
  pictures.weight(std::vector<int>{1, 3}, Eigen::all).setZero();  // light from one side
  AlbedoPrior weak = prior();
  weak.counts = 1e-4F;
  Eigen::ArrayXf there(grid_.count());
  for (Eigen::Index i = 0; i < there.size(); ++i) {
    there[i] = albedo(i);
  }
  const auto off = [&](const Eigen::VectorXd& relief_mm) {
    return (albedo_with_relief(grid_, pictures, weak, relief_mm, 0.5F) / there - 1).abs().mean();
  };
  const float flat = off(Eigen::VectorXd::Zero(grid_.count()));
  EXPECT_LT(off(bump()), 0.8F * flat);
}

TEST_F(PatchTest, FrecklesAreNoRelief) {
  EXPECT_LT(found(Eigen::VectorXd::Zero(grid_.count())).cwiseAbs().maxCoeff(), 0.01 * kBumpMm);
}

/// How well logarithms of brightness agree.
class Agreement {
 public:
  void add(const Eigen::Vector3f& found, const Eigen::Vector3f& truth) {
    const auto logarithm = [](const Eigen::Vector3f& rgb) {
      return std::log(std::max(static_cast<double>(rgb.mean()), 1e-4));
    };
    const double a = logarithm(found);
    const double b = logarithm(truth);
    sums_ += (Eigen::Matrix<double, 6, 1>() << 1, a, b, a * a, b * b, a * b).finished();
  }
  double correlation() const {
    const Eigen::Matrix<double, 6, 1> mean = sums_ / sums_[0];
    return (mean[5] - mean[1] * mean[2]) /
           std::sqrt((mean[3] - mean[1] * mean[1]) * (mean[4] - mean[2] * mean[2]));
  }

 private:
  Eigen::Matrix<double, 6, 1> sums_ = Eigen::Matrix<double, 6, 1>::Zero();
};

TEST(SkinTest, AnActorsTurnShowsTheAlbedo) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "minutes under a sanitizer; the parts have tests of their own";
#endif
  if (!std::filesystem::exists(default_model_file())) {
    GTEST_SKIP() << "no " << default_model_file() << ": facet model build makes it";
  }
  const face::FaceModel model = face::FaceModel::load(default_model_file());
  const simulation::ActorSequence actor(model, actors_turn());
  const Observed observed = look_at(model, actor);
  const CameraIntrinsics& camera = actor.camera();
  const Eigen::Vector2d centre_px(camera.cx, camera.cy);
  // The shape is the actor's as far as the model knows it, seen as he was.
  const auto place = [&](const std::vector<Keyframe>& pictures, ShapeSolver& solver) {
    for (const Keyframe& keyframe : pictures) {
      Eigen::Isometry3d head = keyframe.camera_from_head;
      head.translation().z() /= kShort;
      solver.heads().push_back({head.linear(), head.translation(), observed.rest});
    }
  };
  ShapeSolver solver(model, actor.identity(), camera.fx, centre_px, true);
  place(observed.keyframes, solver);
  constexpr int kTexels = 256;
  int pieces = 0;
  const Skin skin = find_skin(model, kTexels, observed.keyframes, solver, centre_px, [&] { ++pieces; });
  EXPECT_EQ(pieces, skin_pieces(static_cast<int>(observed.keyframes.size()), 0));
  // Pictures of lamps that fired in turn have each a light of their own, or are not understood.
  std::vector<Keyframe> all = observed.keyframes;
  all.insert(all.end(), observed.burst.begin(), observed.burst.end());
  place(observed.burst, solver);
  pieces = 0;
  const Skin lit = find_skin(model, kTexels, all, solver, centre_px, [&] { ++pieces; });
  EXPECT_EQ(pieces, skin_pieces(static_cast<int>(all.size()), observed.light_count()));
  EXPECT_EQ(skin.lamps, 0);
  EXPECT_EQ(lit.lamps, 4);
  const double told = lit.residual;
  EXPECT_LT(told, 0.1);
  // Without a picture that shows the room alone no lamp is told from it.
  std::vector<Keyframe> always_lit = all;
  always_lit.pop_back();
  const HeadState dark_head = solver.heads().back();
  solver.heads().pop_back();
  EXPECT_EQ(find_skin(model, kTexels, always_lit, solver, centre_px, [] {}).lamps, 0);
  solver.heads().push_back(dark_head);
  for (Keyframe& keyframe : all) {
    keyframe.light = 0;
  }
  EXPECT_GT(find_skin(model, kTexels, all, solver, centre_px, [] {}).residual, 1.3 * told);
  const TextureChart chart = face_chart(model, kTexels);
  ASSERT_EQ(skin.chart.width, chart.width());
  ASSERT_EQ(skin.chart.height, chart.height());
  const report::Truth truth(actor.neutral());
  const mesh::Vertices surface_mm = solver.surface(observed.rest).cast<float>();
  Agreement generic;
  Agreement own;
  for (std::size_t texel = 0; texel < chart.triangle().size(); ++texel) {
    EXPECT_TRUE(std::isfinite(skin.chart.relief_mm[texel]));
    if (chart.triangle()[texel] < 0) {
      EXPECT_EQ(skin.chart.relief_mm[texel], 0);
      EXPECT_EQ(skin.chart.albedo[3 * texel], 0);
      continue;
    }
    const auto closest = truth.caster().closest_point(chart.spread(surface_mm, texel), 3);
    if (closest.triangle < 0 || skin.seen[texel] < 2) {
      continue;
    }
    const auto corners = truth.mesh().triangles.col(closest.triangle);
    const Eigen::Vector3f there =
        truth.mesh().albedo(Eigen::all, corners) *
        Eigen::Vector3f(1 - closest.barycentric.sum(), closest.barycentric[0], closest.barycentric[1]);
    generic.add(chart.spread(model.mean_albedo, texel), there);
    own.add(Eigen::Map<const Eigen::Vector3f>(skin.chart.albedo.data() + 3 * texel), there);
  }
  RecordProperty("correlation", std::to_string(own.correlation()));
  EXPECT_GT(own.correlation(), generic.correlation() + 0.2)
      << own.correlation() << " against " << generic.correlation();
  EXPECT_LT(skin.residual, 0.1);
}

}  // namespace
}  // namespace facet::person
