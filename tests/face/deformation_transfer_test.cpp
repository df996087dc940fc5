#include "face/deformation_transfer.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "facet/error.hpp"
#include "mesh/quads.hpp"
#include "support/synthetic_model.hpp"

namespace facet::face {
namespace {

constexpr unsigned kSeed = 2004;

/// The synthetic head with its border fixed.
class DeformationTransferTest : public ::testing::Test {
 protected:
  DeformationTransferTest()
      : model_(test::synthetic_model(21)), triangles_(mesh::split_quads(model_.control.quads)) {
    source_ = model_.core_row(0, 0).cast<double>();
    for (const std::uint8_t bits : model_.regions) {
      fixed_.push_back(face::has_region(bits, face::Region::Boundary) ? 1 : 0);
    }
  }

  /// An expression of the model, faded out towards the border that is fixed.
  Eigen::Matrix3Xd expression(int e) const {
    Eigen::Matrix3Xd delta = model_.core_row(0, e + 1).cast<double>();
    for (Eigen::Index v = 0; v < delta.cols(); ++v) {
      if (fixed_[static_cast<std::size_t>(v)] != 0) {
        delta.col(v).setZero();
      }
    }
    return delta;
  }

  face::FaceModel model_;
  mesh::Triangles triangles_;
  Eigen::Matrix3Xd source_;
  std::vector<std::uint8_t> fixed_;
};

TEST_F(DeformationTransferTest, OntoTheSourceItselfGivesTheSameDisplacements) {
  const DeformationTransfer transfer(source_, source_, triangles_, fixed_);
  for (int e = 0; e < model_.expression_count(); ++e) {
    const Eigen::Matrix3Xd delta = expression(e);
    EXPECT_LT((transfer.transfer(delta) - delta).cwiseAbs().maxCoeff(), 1e-8) << e;
  }
}

TEST_F(DeformationTransferTest, NoDisplacementStaysNone) {
  const Eigen::Matrix3Xd target = source_ + model_.core_row(1, 0).cast<double>();
  const DeformationTransfer transfer(source_, target, triangles_, fixed_);
  EXPECT_TRUE(transfer.transfer(Eigen::Matrix3Xd::Zero(3, source_.cols())).isZero(1e-12));
}

TEST_F(DeformationTransferTest, TurnsAndScalesWithTheWholeSetting) {
  // A source and target that are turned and moved together give turned displacements.
  const Eigen::Matrix3Xd target = source_ + 2.0 * model_.core_row(3, 0).cast<double>();
  const Eigen::Isometry3d motion =
      Eigen::Translation3d(30, -20, 500) * Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized());
  const Eigen::Matrix3Xd delta = expression(3);
  const Eigen::Matrix3Xd here = DeformationTransfer(source_, target, triangles_, fixed_).transfer(delta);
  const Eigen::Matrix3Xd there = DeformationTransfer(motion * source_, motion * target, triangles_, fixed_)
                                     .transfer(motion.linear() * delta);
  EXPECT_LT((there - motion.linear() * here).cwiseAbs().maxCoeff(), 1e-7);

  // A target twice as large is displaced twice as far.
  const Eigen::Matrix3Xd large =
      DeformationTransfer(source_, 2.0 * source_, triangles_, fixed_).transfer(delta);
  EXPECT_LT((large - 2.0 * delta).cwiseAbs().maxCoeff(), 1e-7);
}

TEST_F(DeformationTransferTest, AWiderFaceSmilesWider) {
  Eigen::Matrix3Xd target = source_;
  target.row(0) *= 1.3;
  const int smile = model_.expression_index("mouthSmileLeft");
  const Eigen::Matrix3Xd delta = expression(smile);
  const Eigen::Matrix3Xd carried = DeformationTransfer(source_, target, triangles_, fixed_).transfer(delta);
  const double before = delta.row(0).maxCoeff();
  const double after = carried.row(0).maxCoeff();
  EXPECT_GT(after, 1.1 * before);
  EXPECT_LT(after, 1.5 * before);
}

TEST_F(DeformationTransferTest, FixedVerticesStay) {
  const Eigen::Matrix3Xd target = source_ + 2.0 * model_.core_row(4, 0).cast<double>();
  const Eigen::Matrix3Xd carried =
      DeformationTransfer(source_, target, triangles_, fixed_).transfer(expression(0));
  for (std::size_t v = 0; v < fixed_.size(); ++v) {
    if (fixed_[v] != 0) {
      EXPECT_TRUE(carried.col(static_cast<Eigen::Index>(v)).isZero(0)) << v;
    }
  }
}

TEST_F(DeformationTransferTest, AgreesWithTheLeastSquaresOfItsDefinition) {
  // Sumner & Popovic's energy with Botsch's weights: sum over triangles of area |gradient difference|^2. At
  // its minimum no small change of the free vertices makes it smaller.
  SCOPED_TRACE(kSeed);
  const Eigen::Matrix3Xd target = source_ + 1.5 * model_.core_row(4, 0).cast<double>();
  const Eigen::Matrix3Xd delta = expression(0);
  const Eigen::Matrix3Xd carried = DeformationTransfer(source_, target, triangles_, fixed_).transfer(delta);
  const auto energy = [&](const Eigen::Matrix3Xd& displacement) {
    double sum = 0;
    for (Eigen::Index t = 0; t < triangles_.cols(); ++t) {
      Eigen::Matrix3d rest;
      Eigen::Matrix3d posed;
      Eigen::Matrix<double, 3, 2> target_edges;
      Eigen::Matrix<double, 3, 2> moved_edges;
      for (int k = 0; k < 3; ++k) {
        rest.col(k) = source_.col(triangles_(k, t));
        posed.col(k) = rest.col(k) + delta.col(triangles_(k, t));
      }
      for (int k = 0; k < 2; ++k) {
        target_edges.col(k) = target.col(triangles_(k + 1, t)) - target.col(triangles_(0, t));
        moved_edges.col(k) =
            displacement.col(triangles_(k + 1, t)) - displacement.col(triangles_(0, t)) + target_edges.col(k);
      }
      const Eigen::Matrix3d wanted = deformation_gradient(rest, posed);
      // The gradient of a linear map on the triangle's plane: difference of edges times the edges'
      // pseudo-inverse.
      const Eigen::Matrix<double, 2, 3> inverse =
          (target_edges.transpose() * target_edges).inverse() * target_edges.transpose();
      const double area = 0.5 * target_edges.col(0).cross(target_edges.col(1)).norm();
      sum += area * ((moved_edges - wanted * target_edges) * inverse).squaredNorm();
    }
    return sum;
  };
  const double least = energy(carried);
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 20; ++trial) {
    Eigen::Matrix3Xd change(3, carried.cols());
    for (Eigen::Index v = 0; v < change.cols(); ++v) {
      for (int axis = 0; axis < 3; ++axis) {
        change(axis, v) = fixed_[static_cast<std::size_t>(v)] != 0 ? 0.0 : 0.01 * normal(random);
      }
    }
    EXPECT_GT(energy(carried + change), least);
    EXPECT_GT(energy(carried - change), least);
  }
}

TEST_F(DeformationTransferTest, APartWithoutAFixedVertexIsRefused) {
  EXPECT_THROW(DeformationTransfer(source_, source_, triangles_, std::vector<std::uint8_t>(fixed_.size(), 0)),
               Error);
}

TEST(DeformationGradient, OfALinearMapIsThatMapInThePlane) {
  Eigen::Matrix3d corners;
  corners << 0, 4, 1, 0, 0, 3, 0, 0, 0;
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(0.9, Eigen::Vector3d(1, -1, 2).normalized()).toRotationMatrix();
  EXPECT_TRUE(deformation_gradient(corners, turn * corners).isApprox(turn, 1e-12));
  // The normal is scaled by the root of the area's change: twice as large in the plane gives twice along it.
  EXPECT_TRUE(
      deformation_gradient(corners, 2.0 * corners).isApprox(2.0 * Eigen::Matrix3d::Identity(), 1e-12));
}

}  // namespace
}  // namespace facet::face
