#include "animate/influence.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "facet/error.hpp"

namespace facet::animate {
namespace {

/// Control points closer than this share a region's width: below, a region would be a spike of the mesh.
constexpr double kLeastRadius_mm = 4;
/// Weights below this part of the largest are 0: 20 mm of motion times it is 2 micrometres.
constexpr double kLeastWeight = 1e-4;

void add_row(RegionWeights& rows, const Eigen::VectorXd& weights) {
  const double least = kLeastWeight * weights.maxCoeff();
  double total = 0;
  for (Eigen::Index l = 0; l < weights.size(); ++l) {
    total += weights[l] >= least ? weights[l] : 0.0;
  }
  for (Eigen::Index l = 0; l < weights.size(); ++l) {
    if (weights[l] >= least) {
      rows.regions.push_back(static_cast<std::uint8_t>(l));
      rows.weights.push_back(static_cast<float>(weights[l] / total));
    }
  }
  rows.offsets.push_back(static_cast<std::int32_t>(rows.weights.size()));
}

/// [region_count] B of [SF04 eq. 22] of every control point at one place; the sum is 1.
///
/// at       the place, mm
/// centres  [3][region_count] of the control points, mm
/// radii    [region_count] mm
///
/// The largest exponent is subtracted from all of them, which leaves the quotients as they are. Otherwise,
/// far from all control points, every exponential would underflow and each quotient be 0 / 0.
Eigen::VectorXd influences(const Eigen::Vector3d& at, const Eigen::Matrix3Xd& centres,
                           const Eigen::VectorXd& radii) {
  Eigen::VectorXd exponents(centres.cols());
  for (Eigen::Index l = 0; l < centres.cols(); ++l) {
    exponents[l] = -(at - centres.col(l)).squaredNorm() / (radii[l] * radii[l]);
  }
  const Eigen::VectorXd raised = (exponents.array() - exponents.maxCoeff()).exp();
  return raised / raised.sum();
}

}  // namespace

Eigen::VectorXf RegionWeights::region(int index) const {
  Eigen::VectorXf out = Eigen::VectorXf::Zero(static_cast<Eigen::Index>(offsets.size()) - 1);
  for (std::size_t v = 0; v + 1 < offsets.size(); ++v) {
    for (std::int32_t k = offsets[v]; k < offsets[v + 1]; ++k) {
      if (regions[static_cast<std::size_t>(k)] == index) {
        out[static_cast<Eigen::Index>(v)] = weights[static_cast<std::size_t>(k)];
      }
    }
  }
  return out;
}

void check_controls(const TakeBasis& basis, std::span<const std::int32_t> vertices) {
  if (vertices.size() > static_cast<std::size_t>(kMostControls)) {
    throw Error(ErrorKind::Usage,
                fmt::format("{} control points: {} at most", vertices.size(), kMostControls));
  }
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (vertices[i] < 0 || vertices[i] >= basis.finest_count()) {
      throw Error(ErrorKind::Usage, fmt::format("vertex {} is not on the mesh: its vertices are 0 to {}",
                                                vertices[i], basis.finest_count() - 1));
    }
    if (std::find(vertices.begin(), vertices.begin() + static_cast<std::ptrdiff_t>(i), vertices[i]) !=
        vertices.begin() + static_cast<std::ptrdiff_t>(i)) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("two control points are on vertex {}: it can be in one place only", vertices[i]));
    }
  }
}

InfluenceMaps::InfluenceMaps(const TakeBasis& basis, std::span<const std::int32_t> vertices, bool whole)
    : region_count_(whole ? 1 : std::max(1, static_cast<int>(vertices.size()))),
      vertices_(vertices.begin(), vertices.end()) {
  check_controls(basis, vertices);
  const Eigen::Index count = region_count_;
  Eigen::Matrix3Xd centres = Eigen::Matrix3Xd::Zero(3, count);
  Eigen::VectorXd radii = Eigen::VectorXd::Constant(count, 1.0);
  if (count > 1) {
    for (Eigen::Index l = 0; l < count; ++l) {
      centres.col(l) = basis.rest_mm().col(vertices_[static_cast<std::size_t>(l)]).cast<double>();
    }
    for (Eigen::Index l = 0; l < count; ++l) {
      double nearest_mm = std::numeric_limits<double>::max();
      for (Eigen::Index other = 0; other < count; ++other) {
        nearest_mm =
            other == l ? nearest_mm : std::min(nearest_mm, (centres.col(l) - centres.col(other)).norm());
      }
      radii[l] = std::max(nearest_mm, kLeastRadius_mm);
    }
  }

  const Eigen::Map<const Eigen::Matrix3Xf> controls_mm(basis.coarse_mean().data(), 3, basis.control_count());
  control_.offsets.push_back(0);
  Eigen::MatrixXf dense(count, basis.control_count());
  for (Eigen::Index c = 0; c < basis.control_count(); ++c) {
    add_row(control_, influences(controls_mm.col(c).cast<double>(), centres, radii));
    dense.col(c).setZero();
    const auto row = static_cast<std::size_t>(c);
    for (std::int32_t k = control_.offsets[row]; k < control_.offsets[row + 1]; ++k) {
      dense(control_.regions[static_cast<std::size_t>(k)], c) = control_.weights[static_cast<std::size_t>(k)];
    }
  }
  eyes_ = Eigen::MatrixXf::Zero(count, basis.eye_count());
  for (Eigen::Index e = 0; e < basis.eye_count(); ++e) {
    for (Eigen::Index c = 0; c < basis.control_count(); ++c) {
      if (basis.eye_of_vertex()[static_cast<std::size_t>(c)] == e + 1) {
        eyes_.col(e) += dense.col(c);
      }
    }
    eyes_.col(e) /= eyes_.col(e).sum();
  }
  shares_ = dense.rowwise().sum() / dense.sum();

  for (const mesh::Level& level : basis.hierarchy().levels) {
    Eigen::MatrixXf finer;
    mesh::apply(level.from_coarser, dense, finer);
    dense = std::move(finer);
  }
  finest_.offsets.push_back(0);
  for (Eigen::Index v = 0; v < dense.cols(); ++v) {
    add_row(finest_, dense.col(v).cast<double>().cwiseMax(0.0));
  }
}

Eigen::VectorXf captured_state(const TakeBasis& basis, Eigen::Index frame) {
  Eigen::VectorXf state(basis.coefficient_count() + basis.detail_rank());
  state.head(basis.coefficient_count()) = basis.coefficients().col(frame);
  state.tail(basis.detail_rank()) = state.segment(basis.coarse_rank(), basis.detail_rank());
  return state;
}

void blend(const TakeBasis& basis, const Pose& pose, mesh::MeshFrame& frame) {
  const InfluenceMaps& maps = *pose.maps;
  const Eigen::Index coarse_rank = basis.coarse_rank();
  const Eigen::Index detail_rank = basis.detail_rank();
  frame.control_vertices_mm.resize(3, basis.control_count());
  std::array<float, kMaxRank> buffer{};
  Eigen::Map<Eigen::VectorXf> mixed(buffer.data(), coarse_rank);

  const auto coarse = basis.coarse();
  const auto coarse_mean = basis.coarse_mean();
  for (Eigen::Index c = 0; c < basis.control_count(); ++c) {
    const auto row = static_cast<std::size_t>(c);
    const std::int32_t first = maps.control().offsets[row];
    const std::int32_t end = maps.control().offsets[row + 1];
    mixed.setZero();
    for (std::int32_t k = first; k < end; ++k) {
      const auto entry = static_cast<std::size_t>(k);
      mixed +=
          maps.control().weights[entry] * pose.state.col(maps.control().regions[entry]).head(coarse_rank);
    }
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      frame.control_vertices_mm(axis, c) = coarse_mean[3 * c + axis] + coarse.col(3 * c + axis).dot(mixed);
    }
  }

  // Eyeballs turn and shift as a whole; blended as rotation vectors, for eyes turn little from frame to
  // frame.
  const auto eye_of_vertex = basis.eye_of_vertex();
  for (Eigen::Index e = 0; e < basis.eye_count(); ++e) {
    Eigen::Matrix<float, 6, 1> motion = basis.eye_means().segment<6>(6 * e);
    for (Eigen::Index l = 0; l < maps.region_count(); ++l) {
      motion += maps.eyes()(l, e) * pose.state.col(l).segment<6>(basis.eye_offset() + 6 * e);
    }
    const Eigen::AngleAxisf turn(motion.head<3>().norm(), motion.head<3>().stableNormalized());
    Eigen::Vector3f middle = Eigen::Vector3f::Zero();
    float vertices = 0;
    for (Eigen::Index c = 0; c < basis.control_count(); ++c) {
      if (eye_of_vertex[static_cast<std::size_t>(c)] == e + 1) {
        middle += coarse_mean.segment<3>(3 * c);
        vertices += 1;
      }
    }
    middle /= std::max(vertices, 1.0F);
    for (Eigen::Index c = 0; c < basis.control_count(); ++c) {
      if (eye_of_vertex[static_cast<std::size_t>(c)] == e + 1) {
        frame.control_vertices_mm.col(c) =
            turn * Eigen::Vector3f(coarse_mean.segment<3>(3 * c) - middle) + middle + motion.tail<3>();
      }
    }
  }

  if (detail_rank > 0) {
    frame.displacements_mm.resize(static_cast<std::size_t>(basis.finest_count()));
    const auto detail = basis.detail();
    const auto folds = basis.folds();
    const auto detail_mean = basis.detail_mean();
    const Eigen::Index fold_offset = basis.coefficient_count();
    std::array<float, kMaxRank> second_buffer{};
    Eigen::Map<Eigen::VectorXf> broad(buffer.data(), detail_rank);
    Eigen::Map<Eigen::VectorXf> sharper(second_buffer.data(), detail_rank);
    for (Eigen::Index v = 0; v < basis.finest_count(); ++v) {
      const auto row = static_cast<std::size_t>(v);
      const std::int32_t first = maps.finest().offsets[row];
      const std::int32_t end = maps.finest().offsets[row + 1];
      broad.setZero();
      sharper.setZero();
      for (std::int32_t k = first; k < end; ++k) {
        const auto entry = static_cast<std::size_t>(k);
        const float weight = maps.finest().weights[entry];
        const auto column = pose.state.col(maps.finest().regions[entry]);
        broad += weight * column.segment(coarse_rank, detail_rank);
        sharper += weight * column.segment(fold_offset, detail_rank);
      }
      sharper -= broad;
      frame.displacements_mm[row] = detail_mean[v] + detail.col(v).dot(broad) + folds.col(v).dot(sharper);
    }
  } else {
    frame.displacements_mm.clear();
  }

  frame.expression.resize(static_cast<std::size_t>(basis.expression_count()));
  for (Eigen::Index e = 0; e < basis.expression_count(); ++e) {
    float weight = basis.expression_means()[e];
    for (Eigen::Index l = 0; l < maps.region_count(); ++l) {
      weight += maps.shares()[l] * pose.state(basis.expression_offset() + e, l);
    }
    frame.expression[static_cast<std::size_t>(e)] = std::clamp(weight, 0.0F, 1.0F);
  }
}

mesh::MeshFrame blank_frame(const TakeBasis& basis) {
  const mesh::MeshFrame& sample = basis.sample();
  mesh::MeshFrame frame;
  frame.state = mesh::TrackingState::Tracking;
  frame.camera = sample.camera;
  frame.subject = sample.subject;
  frame.camera_from_head = sample.camera_from_head;
  frame.confidence = sample.confidence;
  frame.lighting = sample.lighting;
  frame.albedo = sample.albedo;
  return frame;
}

}  // namespace facet::animate
