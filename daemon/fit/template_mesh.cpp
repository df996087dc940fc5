#include "fit/template_mesh.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "face/face_parts.hpp"
#include "facet/error.hpp"
#include "fit/first_shape.hpp"
#include "maths/statistics.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::fit {

namespace {

using Eigen::Matrix3d;
using Eigen::Matrix3Xd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr std::size_t kLeastCorrespondences = 6;
constexpr double kOutlierFactor = 4;  ///< times the median distance
constexpr double kOutlierLeastMm = 10;
constexpr double kAffineRidgeMm = 15;  ///< how far the affine map's shear is trusted against the similarity
constexpr double kSpreadMm = 18;       ///< of a correspondence's residual

/// Rows a, then b: what a vertex is of the columns of the second.
mesh::SparseRows product(const mesh::SparseRows& outer, const mesh::SparseRows& inner) {
  mesh::SparseRows result;
  result.row_offsets.push_back(0);
  std::vector<std::pair<std::int32_t, float>> row;
  for (std::int32_t r = 0; r < outer.row_count(); ++r) {
    row.clear();
    for (auto o = outer.row_offsets[static_cast<std::size_t>(r)];
         o < outer.row_offsets[static_cast<std::size_t>(r) + 1]; ++o) {
      const auto middle = static_cast<std::size_t>(outer.columns[static_cast<std::size_t>(o)]);
      for (auto i = inner.row_offsets[middle]; i < inner.row_offsets[middle + 1]; ++i) {
        row.emplace_back(
            inner.columns[static_cast<std::size_t>(i)],
            outer.weights[static_cast<std::size_t>(o)] * inner.weights[static_cast<std::size_t>(i)]);
      }
    }
    std::sort(row.begin(), row.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (i > 0 && row[i].first == row[i - 1].first) {
        result.weights.back() += row[i].second;
      } else {
        result.columns.push_back(row[i].first);
        result.weights.push_back(row[i].second);
      }
    }
    result.row_offsets.push_back(static_cast<std::int32_t>(result.columns.size()));
  }
  return result;
}

/// The affine map [A | t] that brings `from` to `to`, A drawn towards `prior`.
Eigen::Matrix<double, 3, 4> affine(const Matrix3Xd& from, const Matrix3Xd& to, const VectorXd& weights,
                                   const Matrix3d& prior) {
  const double total = weights.sum();
  const Vector3d from_mean = from * weights / total;
  const Vector3d to_mean = to * weights / total;
  const Matrix3Xd a = from.colwise() - from_mean;
  const Matrix3Xd b = to.colwise() - to_mean;
  const double ridge = kAffineRidgeMm * kAffineRidgeMm * total;
  const Matrix3d left = a * weights.asDiagonal() * a.transpose() + ridge * Matrix3d::Identity();
  const Matrix3d right = b * weights.asDiagonal() * a.transpose() + ridge * prior;
  Eigen::Matrix<double, 3, 4> map;
  map.leftCols<3>() = left.ldlt().solve(right.transpose()).transpose();
  map.col(3) = to_mean - map.leftCols<3>() * from_mean;
  return map;
}

}  // namespace

TemplateMesh make_template(const face::FaceModel& model, std::int32_t max_vertices) {
  mesh::Vertices control_mm;
  model.evaluate({}, {}, control_mm);
  // Whole sweeps: every face is larger than the least size and faces the camera.
  mesh::ControlMesh control = model.control;
  std::fill(control.refinable.begin(), control.refinable.end(), std::uint8_t{1});
  const mesh::TextureCoordinates anywhere = 1e6F * control_mm.topRows<2>();
  const std::vector<std::uint8_t> facing(static_cast<std::size_t>(model.vertex_count()), 1);
  mesh::HierarchyOptions options;
  options.min_edge_px = 1e-3F;
  options.max_vertices = max_vertices;
  const auto hierarchy = mesh::build_hierarchy(control, anywhere, facing, options);

  TemplateMesh made;
  for (const mesh::Level& level : hierarchy->levels) {
    made.from_control = made.from_control.row_offsets.empty()
                            ? level.from_coarser
                            : product(level.from_coarser, made.from_control);
  }
  mesh::apply(made.from_control, control_mm, made.neutral_mm);
  for (mesh::Vertices& delta : model.contract_identity({}).deltas_mm) {
    mesh::apply(made.from_control, delta, made.expressions_mm.emplace_back());
  }
  made.triangles = hierarchy->finest().triangles;
  made.one_rings = hierarchy->finest().one_rings;
  const std::vector<face::FacePart> parts =
      model.landmarks.empty() ? std::vector<face::FacePart>() : face::control_parts(model);
  Eigen::MatrixXf shares = Eigen::MatrixXf::Zero(2, model.vertex_count());  // of skin, of the mouth
  for (std::int32_t v = 0; v < model.vertex_count(); ++v) {
    const auto vertex = static_cast<std::size_t>(v);
    const std::uint8_t bits = model.regions[vertex];
    shares(0, v) =
        face::has_region(bits, face::Region::Eye) || face::has_region(bits, face::Region::MouthInterior)
            ? 0.0F
            : 1.0F;
    shares(1, v) = !parts.empty() && parts[vertex] == face::FacePart::Mouth ? 1.0F : 0.0F;
  }
  Eigen::MatrixXf refined;
  mesh::apply(made.from_control, shares, refined);
  for (Eigen::Index v = 0; v < refined.cols(); ++v) {
    made.is_skin.push_back(refined(0, v) > 0.99F ? 1 : 0);
    made.is_mouth.push_back(made.is_skin.back() != 0 && refined(1, v) > 0.5F ? 1 : 0);
  }
  return made;
}

Eigen::Isometry3d align_rigidly(const Eigen::Ref<const Matrix3Xd>& from,
                                const Eigen::Ref<const Matrix3Xd>& to,
                                const Eigen::Ref<const VectorXd>& weights, double* scale) {
  const double total = weights.sum();
  const Vector3d from_mean = from * weights / total;
  const Vector3d to_mean = to * weights / total;
  const Matrix3Xd a = from.colwise() - from_mean;
  const Matrix3Xd b = to.colwise() - to_mean;
  const Eigen::JacobiSVD<Matrix3d> svd(b * weights.asDiagonal() * a.transpose(),
                                       Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Vector3d sign(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1);
  const Matrix3d rotation = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  double factor = 1;
  if (scale != nullptr) {
    const double spread = (a.colwise().squaredNorm() * weights).value();
    factor = spread > 0 ? svd.singularValues().dot(sign) / spread : 1;
    *scale = factor;
  }
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = rotation;
  result.translation() = to_mean - factor * rotation * from_mean;
  return result;
}

Placement place(const TemplateMesh& surface, const FirstShape& shape,
                std::span<const Correspondence> correspondences) {
  const auto count = static_cast<Eigen::Index>(correspondences.size());
  Matrix3Xd from(3, count);
  Matrix3Xd to(3, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Correspondence& one = correspondences[static_cast<std::size_t>(i)];
    from.col(i) = face::FaceModel::anchor_point(one.anchor, shape.shown_mm).cast<double>();
    to.col(i) = one.target_mm;
  }
  Placement placed;
  placed.agrees.assign(correspondences.size(), 1);
  VectorXd weights = VectorXd::Ones(count);
  Eigen::Matrix<double, 3, 4> map = Eigen::Matrix<double, 3, 4>::Zero();
  Matrix3d turned = Matrix3d::Identity();
  VectorXd distance = VectorXd::Zero(count);
  const auto check_count = [&] {
    const auto used =
        static_cast<std::size_t>(std::count(placed.agrees.begin(), placed.agrees.end(), std::uint8_t{1}));
    if (used < kLeastCorrespondences) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format(
              "the template can't be placed: {} of {} landmarks agree with each other, at least {} must",
              used, count, kLeastCorrespondences));
    }
  };
  check_count();
  // First the median's solution (weights 1 / distance), which a third of wrong ones does not move; then what
  // lies far off it is left out.
  constexpr int kMedianRounds = 15;
  constexpr int kRounds = kMedianRounds + 4;
  for (int round = 0; round < kRounds; ++round) {
    const double total = weights.sum();
    const Vector3d mean = from * weights / total;
    const Matrix3Xd centred = from.colwise() - mean;
    const Vector3d spread =
        Eigen::SelfAdjointEigenSolver<Matrix3d>(centred * weights.asDiagonal() * centred.transpose())
            .eigenvalues();
    if (!(spread[1] > 1e-3 * spread[2])) {
      throw Error(ErrorKind::UnreadableInput, "the template can't be placed: its landmarks lie on a line");
    }
    double scale = 1;
    const Eigen::Isometry3d similarity = align_rigidly(from, to, weights, &scale);
    turned = scale * similarity.linear();
    map = affine(from, to, weights, turned);
    distance = ((map.leftCols<3>() * from).colwise() + map.col(3) - to).colwise().norm();
    if (round < kMedianRounds) {
      weights = distance.cwiseMax(1.0).cwiseInverse();
      continue;
    }
    const double limit = std::max(
        kOutlierLeastMm,
        kOutlierFactor * maths::median_of(std::vector<double>(distance.data(), distance.data() + count)));
    for (Eigen::Index i = 0; i < count; ++i) {
      placed.agrees[static_cast<std::size_t>(i)] = distance[i] <= limit ? 1 : 0;
      weights[i] = distance[i] <= limit ? 1 : 0;
    }
    check_count();
  }
  placed.rms_mm = std::sqrt(distance.cwiseAbs2().dot(weights) / std::max(weights.sum(), 1.0));
  const Matrix3Xd moved = (map.leftCols<3>() * from).colwise() + map.col(3);
  mesh::Vertices fine_mm;
  for (const mesh::Vertices& delta : shape.deltas_mm) {
    mesh::apply(surface.from_control, delta, fine_mm);
    placed.rest.expressions_mm.emplace_back(turned.cast<float>() * fine_mm);
  }
  placed.expression = shape.expression;
  mesh::apply(surface.from_control, shape.shown_mm, fine_mm);
  placed.shown_mm.resize(3, surface.vertex_count());
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    const Vector3d at = map.leftCols<3>() * fine_mm.col(v).cast<double>() + map.col(3);
    Vector3d sum = Vector3d::Zero();
    double total = 1e-3;  // far from all landmarks nothing is added
    for (Eigen::Index i = 0; i < count; ++i) {
      const double near =
          weights[i] * std::exp(-(at - moved.col(i)).squaredNorm() / (2 * kSpreadMm * kSpreadMm));
      sum += near * (to.col(i) - moved.col(i));
      total += near;
    }
    placed.shown_mm.col(v) = (at + sum / total).cast<float>();
  }
  mesh::apply(surface.from_control, shape.shown_mm - shape.neutral_mm, fine_mm);
  placed.rest.vertices_mm = placed.shown_mm - turned.cast<float>() * fine_mm;
  return placed;
}

}  // namespace facet::fit
