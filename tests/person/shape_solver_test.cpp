#include "person/shape_solver.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "maths/alignment.hpp"
#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

constexpr double kTrueFocalPx = 1300;
constexpr double kGuessedFocalPx = 1040;
const Eigen::Vector2d kCentrePx(640, 360);

/// A head that differs from the model's mean by identities and by a bump that no identity makes, seen while
/// it turns.
class ShapeSolverTest : public ::testing::Test {
 protected:
  ShapeSolverTest() : model_(test::synthetic_model(21)) {
    std::vector<float> identity(static_cast<std::size_t>(model_.identity_count()));
    identity[0] = 0.8F;
    identity[3] = -0.7F;
    model_.evaluate(identity, {}, truth_mm_);
    for (Eigen::Index v = 0; v < truth_mm_.cols(); ++v) {
      const Eigen::Vector3f p = truth_mm_.col(v);
      truth_mm_(2, v) += 2.5F * test::synthetic::bump(p.x(), p.y(), -30, -40, 16);
    }
  }

  static Eigen::Matrix3d turned(double yaw_deg, double pitch_deg) {
    const double radians = std::numbers::pi / 180;
    return Eigen::Vector3d(1, -1, -1).asDiagonal() *
           (Eigen::AngleAxisd(yaw_deg * radians, Eigen::Vector3d::UnitY()) *
            Eigen::AngleAxisd(pitch_deg * radians, Eigen::Vector3d::UnitX()))
               .toRotationMatrix();
  }

  /// What the head shows in seven orientations, `noise_px` off; poses start as a camera of the guessed focal
  /// length has them.
  void look(ShapeSolver& solver, double span_deg, double noise_px) {
    const mesh::SparseRows rows = surface_rows(model_);
    mesh::Vertices surface_mm;
    mesh::apply(rows, truth_mm_, surface_mm);
    std::mt19937 random(7);
    std::normal_distribution<double> noise(0, noise_px);
    std::vector<SkinPoints> points;
    for (int k = 0; k < 7; ++k) {
      const double yaw = span_deg * (k / 6.0 - 0.5);
      const Eigen::Matrix3d rotation = turned(yaw, k % 2 == 0 ? 4 : -4);
      const Eigen::Vector3d translation(3 * k - 9, 2, 650);
      SkinPoints seen{Eigen::Matrix2Xd::Zero(2, model_.vertex_count()),
                      std::vector<float>(static_cast<std::size_t>(model_.vertex_count()), 0)};
      for (const std::int32_t v : solver.skin()) {
        const Eigen::Vector3d p = rotation * surface_mm.col(v).cast<double>() + translation;
        seen.measured_px.col(v) =
            kTrueFocalPx / p.z() * p.head<2>() + kCentrePx + Eigen::Vector2d(noise(random), noise(random));
        seen.confidence[static_cast<std::size_t>(v)] = 1;
      }
      points.push_back(seen);
      const double nearer = kGuessedFocalPx / kTrueFocalPx;
      solver.heads().push_back({rotation,
                                Eigen::Vector3d(translation.x(), translation.y(), translation.z() * nearer),
                                Eigen::VectorXd::Zero(model_.expression_count())});
    }
    solver.set_points(points, std::vector<char>(points.size(), 1));
  }

  /// Mean distance from the truth over the skin, mm, a similarity taken out.
  double error_mm(const ShapeSolver& solver, const Eigen::Matrix3Xd& found) const {
    Eigen::Matrix3Xf from(3, static_cast<Eigen::Index>(solver.skin().size()));
    Eigen::Matrix3Xf to(3, from.cols());
    for (std::size_t i = 0; i < solver.skin().size(); ++i) {
      from.col(static_cast<Eigen::Index>(i)) = found.col(solver.skin()[i]).cast<float>();
      to.col(static_cast<Eigen::Index>(i)) = truth_mm_.col(solver.skin()[i]);
    }
    return static_cast<double>(
        (maths::best_similarity(from, to, true).apply(from) - to).colwise().norm().mean());
  }

  face::FaceModel model_;
  mesh::Vertices truth_mm_;
};

TEST_F(ShapeSolverTest, ATurningHeadShowsItsShapeAndTheFocalLength) {
  ShapeSolver solver(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                     kGuessedFocalPx, kCentrePx, false);
  look(solver, 60, 0.3);
  const double before = error_mm(solver, solver.generic_control());
  ASSERT_TRUE(solver.bundle(3, false, true));
  ASSERT_TRUE(solver.bundle(5, true, true));
  ASSERT_TRUE(solver.bundle(6, true, false));
  const double after = error_mm(solver, solver.control_in_gauge());
  EXPECT_GT(before, 1.0);
  EXPECT_LT(after, 0.25 * before);
  EXPECT_NEAR(solver.focal_px() / kTrueFocalPx, 1, 0.02);
}

TEST_F(ShapeSolverTest, AKnownFocalLengthStays) {
  ShapeSolver solver(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                     kTrueFocalPx, kCentrePx, true);
  look(solver, 40, 0.3);
  for (HeadState& head : solver.heads()) {
    head.translation_mm.z() *= kTrueFocalPx / kGuessedFocalPx;
  }
  ASSERT_TRUE(solver.bundle(6, true, false));
  EXPECT_EQ(solver.focal_px(), kTrueFocalPx);
  EXPECT_LT(error_mm(solver, solver.control_in_gauge()), 0.3 * error_mm(solver, solver.generic_control()));
}

TEST_F(ShapeSolverTest, OutliersDoNotBendTheFace) {
  ShapeSolver solver(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                     kGuessedFocalPx, kCentrePx, false);
  look(solver, 60, 0.3);
  // A patch of a cheek that follows a shadow in two of the pictures.
  std::vector<SkinPoints> points;
  {
    ShapeSolver exact(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                      kGuessedFocalPx, kCentrePx, false);
    look(exact, 60, 0.3);
    const mesh::SparseRows rows = surface_rows(model_);
    mesh::Vertices surface_mm;
    mesh::apply(rows, truth_mm_, surface_mm);
    std::mt19937 random(7);
    for (std::size_t k = 0; k < exact.heads().size(); ++k) {
      SkinPoints seen{Eigen::Matrix2Xd::Zero(2, model_.vertex_count()),
                      std::vector<float>(static_cast<std::size_t>(model_.vertex_count()), 0)};
      const HeadState& head = exact.heads()[k];
      for (const std::int32_t v : exact.skin()) {
        const Eigen::Vector3d p = head.rotation * surface_mm.col(v).cast<double>() +
                                  Eigen::Vector3d(head.translation_mm.x(), head.translation_mm.y(),
                                                  head.translation_mm.z() * kTrueFocalPx / kGuessedFocalPx);
        const bool misled =
            k < 2 && surface_mm(0, v) > 20 && surface_mm(1, v) < -20 && surface_mm(1, v) > -50;
        seen.measured_px.col(v) =
            kTrueFocalPx / p.z() * p.head<2>() + kCentrePx + Eigen::Vector2d(misled ? 12 : 0, 0);
        seen.confidence[static_cast<std::size_t>(v)] = 1;
      }
      points.push_back(seen);
    }
  }
  solver.set_points(points, std::vector<char>(points.size(), 1));
  ASSERT_TRUE(solver.bundle(3, false, true));
  ASSERT_TRUE(solver.bundle(5, true, true));
  ASSERT_TRUE(solver.bundle(6, true, false));
  EXPECT_LT(error_mm(solver, solver.control_in_gauge()), 0.35 * error_mm(solver, solver.generic_control()));
}

TEST_F(ShapeSolverTest, TheExpressionOfAPictureIsFoundWithTheShapeHeld) {
  ShapeSolver solver(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                     kTrueFocalPx, kCentrePx, true);
  const int jaw = model_.expression_index("jawOpen");
  Eigen::VectorXd expression = Eigen::VectorXd::Zero(model_.expression_count());
  expression[jaw] = 0.4;
  const Eigen::Matrix3Xd surface = solver.surface(expression);
  const HeadState head{turned(10, 0), Eigen::Vector3d(0, 0, 650),
                       Eigen::VectorXd::Zero(model_.expression_count())};
  SkinPoints seen{Eigen::Matrix2Xd::Zero(2, model_.vertex_count()),
                  std::vector<float>(static_cast<std::size_t>(model_.vertex_count()), 1)};
  for (const std::int32_t v : solver.skin()) {
    const Eigen::Vector3d p = head.rotation * surface.col(v) + head.translation_mm;
    seen.measured_px.col(v) = kTrueFocalPx / p.z() * p.head<2>() + kCentrePx;
  }
  solver.heads().push_back(head);
  solver.set_points({seen}, {1});
  const Eigen::VectorXd prior = Eigen::VectorXd::Zero(model_.expression_count());
  solver.resect(0, 20, &prior);
  EXPECT_NEAR(solver.heads()[0].expression[jaw], 0.4, 0.03);
  EXPECT_LT(solver.residual_px(0), 0.2);
}

TEST_F(ShapeSolverTest, TheUncertaintyFallsWhereTheHeadTurnsFurther) {
  const auto median_sigma = [&](double span_deg) {
    ShapeSolver solver(model_, std::vector<float>(static_cast<std::size_t>(model_.identity_count())),
                       kTrueFocalPx, kCentrePx, true);
    look(solver, span_deg, 0.3);
    for (HeadState& head : solver.heads()) {
      head.translation_mm.z() *= kTrueFocalPx / kGuessedFocalPx;
    }
    EXPECT_TRUE(solver.bundle(4, true, false));
    const Eigen::VectorXd sigma = solver.uncertainty_mm([] { return true; });
    double sum = 0;
    for (const std::int32_t v : solver.skin()) {
      EXPECT_TRUE(std::isfinite(sigma[v]));
      sum += sigma[v];
    }
    return sum / static_cast<double>(solver.skin().size());
  };
  const double narrow = median_sigma(10);
  const double wide = median_sigma(60);
  EXPECT_GT(wide, 0);
  EXPECT_LT(wide, 0.6 * narrow);
}

}  // namespace
}  // namespace facet::person
