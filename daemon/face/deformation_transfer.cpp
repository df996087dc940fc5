#include "face/deformation_transfer.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>

#include "facet/error.hpp"

namespace facet::face {
namespace {

constexpr double kSliverArea = 1e-8;  // below it a triangle has no shape to pass on

Eigen::Matrix3d corners_of(const Eigen::Matrix3Xd& positions, const mesh::Triangles& triangles,
                           Eigen::Index t) {
  Eigen::Matrix3d corners;
  for (int corner = 0; corner < 3; ++corner) {
    corners.col(corner) = positions.col(triangles(corner, t));
  }
  return corners;
}

/// Two edges and the normal scaled by the root of twice the area: the frame of a triangle.
Eigen::Matrix3d triangle_frame(const Eigen::Matrix3d& corners) {
  Eigen::Matrix3d frame;
  frame.col(0) = corners.col(1) - corners.col(0);
  frame.col(1) = corners.col(2) - corners.col(0);
  const Eigen::Vector3d normal = frame.col(0).cross(frame.col(1));
  frame.col(2) = normal / std::sqrt(std::max(normal.norm(), kSliverArea));
  return frame;
}

/// Cotangents of the three angles; [k] is opposite the edge (k + 1, k + 2).
Eigen::Vector3d cotangents(const Eigen::Matrix3d& corners) {
  Eigen::Vector3d result;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d a = corners.col((k + 1) % 3) - corners.col(k);
    const Eigen::Vector3d b = corners.col((k + 2) % 3) - corners.col(k);
    result[k] = a.dot(b) / std::max(a.cross(b).norm(), kSliverArea);
  }
  return result;
}

}  // namespace

Eigen::Matrix3d deformation_gradient(const Eigen::Matrix3d& rest_corners,
                                     const Eigen::Matrix3d& deformed_corners) {
  return triangle_frame(deformed_corners) * triangle_frame(rest_corners).inverse();
}

struct DeformationTransfer::Impl {
  Eigen::Matrix3Xd source;
  mesh::Triangles triangles;
  std::vector<Eigen::Matrix3d> inverse_source_frames;
  std::vector<Eigen::Matrix3d> weighted_edges;  // target edge (k + 1) - (k + 2) x half the cotangent, per k
  std::vector<int> unknown;                     // per vertex; -1: fixed
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver;
  int unknown_count = 0;
};

DeformationTransfer::DeformationTransfer(const Eigen::Matrix3Xd& source, const Eigen::Matrix3Xd& target,
                                         const mesh::Triangles& triangles,
                                         const std::vector<std::uint8_t>& fixed)
    : impl_(std::make_unique<Impl>()) {
  impl_->source = source;
  impl_->triangles = triangles;
  impl_->unknown.assign(fixed.size(), -1);
  for (std::size_t v = 0; v < fixed.size(); ++v) {
    if (fixed[v] == 0) {
      impl_->unknown[v] = impl_->unknown_count++;
    }
  }
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    Eigen::Matrix3d source_frame = triangle_frame(corners_of(source, triangles, t));
    const bool sliver = std::abs(source_frame.determinant()) < kSliverArea;
    impl_->inverse_source_frames.push_back(sliver ? Eigen::Matrix3d::Zero().eval()
                                                  : Eigen::Matrix3d(source_frame.inverse()));
    const Eigen::Matrix3d corners = corners_of(target, triangles, t);
    const Eigen::Vector3d cotangent = cotangents(corners);
    Eigen::Matrix3d& edges = impl_->weighted_edges.emplace_back();
    for (int k = 0; k < 3; ++k) {
      const int a = (k + 1) % 3;
      const int b = (k + 2) % 3;
      const double weight = 0.5 * cotangent[k];
      edges.col(k) = weight * (corners.col(a) - corners.col(b));
      const int row = impl_->unknown[static_cast<std::size_t>(triangles(a, t))];
      const int column = impl_->unknown[static_cast<std::size_t>(triangles(b, t))];
      if (row >= 0) {
        entries.emplace_back(row, row, weight);
      }
      if (column >= 0) {
        entries.emplace_back(column, column, weight);
      }
      if (row >= 0 && column >= 0) {
        entries.emplace_back(row, column, -weight);
        entries.emplace_back(column, row, -weight);
      }
    }
  }
  Eigen::SparseMatrix<double> laplacian(impl_->unknown_count, impl_->unknown_count);
  laplacian.setFromTriplets(entries.begin(), entries.end());
  impl_->solver.compute(laplacian);
  constexpr double kSingular =
      1e-10;  // of the largest pivot: a floating part leaves a pivot of rounding size
  const Eigen::VectorXd pivots = impl_->solver.vectorD().cwiseAbs();
  if (impl_->solver.info() != Eigen::Success ||
      (pivots.size() > 0 && pivots.minCoeff() < kSingular * pivots.maxCoeff())) {
    throw Error(ErrorKind::Internal, "deformation transfer: a part of the mesh has no fixed vertex");
  }
}

DeformationTransfer::~DeformationTransfer() = default;
DeformationTransfer::DeformationTransfer(DeformationTransfer&&) noexcept = default;

Eigen::Matrix3Xd DeformationTransfer::transfer(const Eigen::Matrix3Xd& source_displacements) const {
  const Impl& impl = *impl_;
  Eigen::MatrixX3d divergence = Eigen::MatrixX3d::Zero(impl.unknown_count, 3);
  const Eigen::Matrix3Xd deformed = impl.source + source_displacements;
  for (Eigen::Index t = 0; t < impl.triangles.cols(); ++t) {
    const auto moves = [&](int corner) {
      return !source_displacements.col(impl.triangles(corner, t)).isZero(0);
    };
    if (!(moves(0) || moves(1) || moves(2))) {
      continue;
    }
    // Displacement of the edges: (gradient - identity) x edge, so that the unknowns are displacements too.
    const Eigen::Matrix3d change = triangle_frame(corners_of(deformed, impl.triangles, t)) *
                                       impl.inverse_source_frames[static_cast<std::size_t>(t)] -
                                   Eigen::Matrix3d::Identity();
    const Eigen::Matrix3d edges = change * impl.weighted_edges[static_cast<std::size_t>(t)];
    for (int k = 0; k < 3; ++k) {
      const int row = impl.unknown[static_cast<std::size_t>(impl.triangles((k + 1) % 3, t))];
      const int column = impl.unknown[static_cast<std::size_t>(impl.triangles((k + 2) % 3, t))];
      if (row >= 0) {
        divergence.row(row) += edges.col(k).transpose();
      }
      if (column >= 0) {
        divergence.row(column) -= edges.col(k).transpose();
      }
    }
  }
  const Eigen::MatrixX3d solved = impl.solver.solve(divergence);
  Eigen::Matrix3Xd displacements = Eigen::Matrix3Xd::Zero(3, source_displacements.cols());
  for (Eigen::Index v = 0; v < displacements.cols(); ++v) {
    if (impl.unknown[static_cast<std::size_t>(v)] >= 0) {
      displacements.col(v) = solved.row(impl.unknown[static_cast<std::size_t>(v)]).transpose();
    }
  }
  return displacements;
}

}  // namespace facet::face
