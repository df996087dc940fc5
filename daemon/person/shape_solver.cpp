#include "person/shape_solver.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <limits>

#include "maths/alignment.hpp"
#include "maths/solve.hpp"
#include "maths/statistics.hpp"
#include "mesh/quads.hpp"

namespace facet::person {
namespace {

using Sparse = Eigen::SparseMatrix<double>;

constexpr float kCounts = 0.3F;  ///< confidence from which a point's residual is looked at
constexpr std::size_t kLeastPoints = 50;
/// Standard deviation of a median distance in two dimensions over that in one.
constexpr double kMedianOfTwo = 1.18;
constexpr double kMadToSigma = 1.4826;
constexpr double kDamping = 1e-6;
/// Flow errs alike in all keyframes, for all are compared with one mean: what adds up as if they were
/// independent is so many times as uncertain (found on turns whose truth is known: bench/results/person.md).
constexpr double kSharedErrors = 3;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Matrix3d turned(const Eigen::Vector3d& by, const Eigen::Matrix3d& rotation) {
  const double angle = by.norm();
  return angle < 1e-15 ? rotation : Eigen::AngleAxisd(angle, by / angle).toRotationMatrix() * rotation;
}

/// A measured point, what it says of a vertex, the head and the camera.
struct Linearised {
  Eigen::Vector2d residual;
  Eigen::Matrix<double, 2, 3> by_vertex;
  Eigen::Matrix<double, 2, 6> by_pose;
  Eigen::Vector2d by_log_focal;
};

}  // namespace

struct ShapeSolver::Impl {
  const face::FaceModel& model;
  AnchorStrength strength;
  Eigen::Vector2d centre_px;
  double generic_focal_px;
  bool focal_is_known;

  mesh::SparseRows to_surface;
  mesh::Vertices generic_control_f;
  Eigen::Matrix3Xd generic_control;              // N0
  Eigen::Matrix3Xd generic_surface;              // P N0
  std::vector<Eigen::Matrix3Xd> modes;           // [identity_count] B on the control mesh
  std::vector<Eigen::Matrix3Xd> surface_modes;   // P B
  std::vector<Eigen::Matrix3Xd> surface_deltas;  // [expression_count] P D
  std::vector<std::int32_t> skin;                // vertices that pictures tell of
  std::vector<std::int32_t> free;                // vertices that delta may move
  std::vector<std::int32_t> place;               // [vertex_count] index in `free`, -1
  Sparse anchor;                                 // [free][free]
  Eigen::SimplicialLDLT<Sparse> factor;
  bool analysed = false;

  // State.
  Eigen::VectorXd identity;  // y
  Eigen::Matrix3Xd delta;    // [3][free], on the surface
  double focal_px;
  std::vector<HeadState> heads;
  std::vector<SkinPoints> points;
  std::vector<char> solves;
  double noise_px = 0.35;
  double least_bound_px = 1;
  bool generic = false;  // the shape found is set aside

  Impl(const face::FaceModel& model_, const std::vector<float>& start, double focal,
       const Eigen::Vector2d& centre, bool known, const AnchorStrength& strength_)
      : model(model_),
        strength(strength_),
        centre_px(centre),
        generic_focal_px(focal),
        focal_is_known(known),
        focal_px(focal) {
    const face::ExpressionBasis basis = model.contract_identity(start);
    to_surface = surface_rows(model);
    generic_control_f = basis.neutral_mm;
    generic_control = basis.neutral_mm.cast<double>();
    generic_surface = on_surface(generic_control);
    for (int i = 1; i <= model.identity_count(); ++i) {
      modes.emplace_back(model.core_row(i, 0).cast<double>());
      surface_modes.push_back(on_surface(modes.back()));
    }
    for (const mesh::Vertices& shape : basis.deltas_mm) {
      surface_deltas.push_back(on_surface(shape.cast<double>()));
    }
    identity = Eigen::VectorXd::Zero(model.identity_count());
    FreeSkin found = free_skin(model);
    skin = std::move(found.skin);
    free = std::move(found.free);
    place.assign(static_cast<std::size_t>(model.vertex_count()), -1);
    for (std::size_t i = 0; i < free.size(); ++i) {
      place[static_cast<std::size_t>(free[i])] = static_cast<std::int32_t>(i);
    }
    anchor = anchor_matrix(model, generic_control, free, found.ring, strength);
    delta = Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(free.size()));
  }

  Eigen::Matrix3Xd on_surface(const Eigen::Matrix3Xd& control) const {
    mesh::Vertices out;
    mesh::apply(to_surface, control.cast<float>().eval(), out);
    return out.cast<double>();
  }

  Eigen::Matrix3Xd neutral_surface() const {
    Eigen::Matrix3Xd out = generic_surface;
    if (generic) {
      return out;
    }
    for (std::size_t i = 0; i < surface_modes.size(); ++i) {
      out += identity[static_cast<Eigen::Index>(i)] * surface_modes[i];
    }
    for (std::size_t i = 0; i < free.size(); ++i) {
      out.col(free[i]) += delta.col(static_cast<Eigen::Index>(i));
    }
    return out;
  }

  Eigen::Matrix3Xd surface(const Eigen::Matrix3Xd& neutral, const Eigen::VectorXd& expression) const {
    Eigen::Matrix3Xd out = neutral;
    for (std::size_t e = 0; e < surface_deltas.size(); ++e) {
      if (const double weight = expression[static_cast<Eigen::Index>(e)]; weight != 0) {
        out += weight * surface_deltas[e];
      }
    }
    return out;
  }

  double focal() const { return generic ? generic_focal_px : focal_px; }

  Linearised linearise(const Eigen::Vector3d& point, const HeadState& head,
                       const Eigen::Vector2d& measured) const {
    const double f = focal();
    const Eigen::Vector3d turned_point = head.rotation * point;
    const Eigen::Vector3d p = turned_point + head.translation_mm;
    const double z = std::max(p.z(), 1.0);
    Linearised out;
    const Eigen::Vector2d on_plane = f / z * p.head<2>();
    out.residual = on_plane + centre_px - measured;
    Eigen::Matrix<double, 2, 3> by_point;
    by_point << f / z, 0, -on_plane.x() / z, 0, f / z, -on_plane.y() / z;
    out.by_vertex = by_point * head.rotation;
    out.by_pose.leftCols<3>() = by_point * -cross_matrix(turned_point);
    out.by_pose.rightCols<3>() = by_point;
    out.by_log_focal = on_plane;
    return out;
  }

  /// [skin] weight of each measured point: its confidence, and little where it lies far off.
  std::vector<double> weights(const Eigen::Matrix3Xd& shape, std::size_t k) const {
    std::vector<double> distance(skin.size(), 0);
    std::vector<double> counted;
    for (std::size_t i = 0; i < skin.size(); ++i) {
      const std::int32_t v = skin[i];
      const float confidence = points[k].confidence[static_cast<std::size_t>(v)];
      if (confidence > 0) {
        distance[i] = distance_px(shape, k, v);
        if (confidence > 0.2F) {
          counted.push_back(distance[i]);
        }
      }
    }
    const double sigma = counted.empty() ? 1 : kMadToSigma * maths::median_of(counted) / kMedianOfTwo;
    const double bound = std::max(3 * sigma, least_bound_px);
    std::vector<double> out(skin.size(), 0);
    for (std::size_t i = 0; i < skin.size(); ++i) {
      const double share = 1 + distance[i] * distance[i] / (bound * bound);
      out[i] =
          points[k].confidence[static_cast<std::size_t>(skin[i])] / (share * share) / (noise_px * noise_px);
    }
    return out;
  }

  double distance_px(const Eigen::Matrix3Xd& shape, std::size_t k, std::int32_t v) const {
    const Eigen::Vector3d p = heads[k].rotation * shape.col(v) + heads[k].translation_mm;
    return (focal() / std::max(p.z(), 1.0) * p.head<2>() + centre_px - points[k].measured_px.col(v)).norm();
  }

  /// The normal equations: A, C and a per free vertex, of what is shared H and g.
  struct Sums {
    std::vector<Eigen::Matrix3d> vertex;  // [free]
    Eigen::MatrixXd coupling;             // [3 free][shared]
    Eigen::MatrixXd vertex_gradient;      // [3 free][1]
    Eigen::MatrixXd shared;               // [shared][shared]
    Eigen::VectorXd shared_gradient;      // [shared]
  };

  /// Order of what is shared: identity, six of each keyframe that solves, log focal length.
  Sums sum_up(bool first) const {
    std::vector<std::size_t> keys;
    for (std::size_t k = 0; k < heads.size(); ++k) {
      if (solves[k] != 0) {
        keys.push_back(k);
      }
    }
    const auto modes_count = static_cast<Eigen::Index>(surface_modes.size());
    const Eigen::Index count = modes_count + 6 * static_cast<Eigen::Index>(keys.size()) + 1;
    const auto n = static_cast<Eigen::Index>(free.size());
    Sums sums{std::vector<Eigen::Matrix3d>(free.size(), Eigen::Matrix3d::Zero()),
              Eigen::MatrixXd::Zero(3 * n, count), Eigen::MatrixXd::Zero(3 * n, 1),
              Eigen::MatrixXd::Zero(count, count), Eigen::VectorXd::Zero(count)};
    const Eigen::Matrix3Xd neutral = neutral_surface();
    for (std::size_t q = 0; q < keys.size(); ++q) {
      const std::size_t k = keys[q];
      const Eigen::Matrix3Xd shape = surface(neutral, heads[k].expression);
      const std::vector<double> weight = weights(shape, k);
      const Eigen::Index pose = modes_count + 6 * static_cast<Eigen::Index>(q);
      Eigen::Matrix<double, 6, 6> by_pose = Eigen::Matrix<double, 6, 6>::Zero();
      Eigen::Matrix<double, 6, 1> pose_focal = Eigen::Matrix<double, 6, 1>::Zero();
      for (std::size_t i = 0; i < skin.size(); ++i) {
        if (weight[i] <= 0) {
          continue;
        }
        const std::int32_t v = skin[i];
        const Linearised line = linearise(shape.col(v), heads[k], points[k].measured_px.col(v));
        const std::int32_t at = place[static_cast<std::size_t>(v)];
        const Eigen::Matrix<double, 3, 2> weighted = weight[i] * line.by_vertex.transpose();
        sums.vertex[static_cast<std::size_t>(at)] += weighted * line.by_vertex;
        sums.vertex_gradient.block<3, 1>(3 * at, 0) += weighted * line.residual;
        sums.coupling.block<3, 6>(3 * at, pose) += weighted * line.by_pose;
        sums.coupling.block<3, 1>(3 * at, count - 1) += weighted * line.by_log_focal;
        by_pose += weight[i] * line.by_pose.transpose() * line.by_pose;
        pose_focal += weight[i] * line.by_pose.transpose() * line.by_log_focal;
        sums.shared_gradient.segment<6>(pose) += weight[i] * line.by_pose.transpose() * line.residual;
        sums.shared_gradient[count - 1] += weight[i] * line.by_log_focal.dot(line.residual);
        sums.shared(count - 1, count - 1) += weight[i] * line.by_log_focal.squaredNorm();
      }
      sums.shared.block<6, 6>(pose, pose) = by_pose;
      sums.shared.block<6, 1>(pose, count - 1) = pose_focal;
      sums.shared.block<1, 6>(count - 1, pose) = pose_focal.transpose();
    }
    add_modes(modes_count, count, sums);
    const double sigma = first ? strength.first_log_focal_sigma : strength.log_focal_sigma;
    sums.shared(count - 1, count - 1) += 1 / (sigma * sigma);
    sums.shared_gradient[count - 1] += std::log(focal_px / generic_focal_px) / (sigma * sigma);
    // The anchor's own gradient.
    const Eigen::MatrixXd pull = anchor * delta.transpose();  // [free][3]
    for (Eigen::Index i = 0; i < n; ++i) {
      sums.vertex_gradient.block<3, 1>(3 * i, 0) += pull.row(i).transpose();
    }
    return sums;
  }

  /// The identity modes move every vertex: their rows follow from the vertices'.
  void add_modes(Eigen::Index modes_count, Eigen::Index count, Sums& sums) const {
    if (modes_count == 0) {
      return;
    }
    Eigen::MatrixXd modes_at(3 * static_cast<Eigen::Index>(free.size()), modes_count);
    for (Eigen::Index m = 0; m < modes_count; ++m) {
      for (std::size_t i = 0; i < free.size(); ++i) {
        modes_at.block<3, 1>(3 * static_cast<Eigen::Index>(i), m) =
            surface_modes[static_cast<std::size_t>(m)].col(free[i]);
      }
    }
    for (std::size_t i = 0; i < free.size(); ++i) {
      const Eigen::Index row = 3 * static_cast<Eigen::Index>(i);
      sums.coupling.block(row, 0, 3, modes_count) = sums.vertex[i] * modes_at.middleRows<3>(row);
    }
    sums.shared.topLeftCorner(modes_count, modes_count) =
        modes_at.transpose() * sums.coupling.leftCols(modes_count) +
        Eigen::MatrixXd::Identity(modes_count, modes_count);
    const Eigen::Index others = count - modes_count;
    sums.shared.topRightCorner(modes_count, others) = modes_at.transpose() * sums.coupling.rightCols(others);
    sums.shared.bottomLeftCorner(others, modes_count) =
        sums.shared.topRightCorner(modes_count, others).transpose();
    sums.shared_gradient.head(modes_count) = modes_at.transpose() * sums.vertex_gradient + identity;
  }

  /// [3 free][7] functionals of the skin that tell the head's place, turn and size.
  Eigen::MatrixXd gauge_functionals() const {
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(3 * static_cast<Eigen::Index>(free.size()), 7);
    const Eigen::Vector3d middle = generic_surface(Eigen::all, skin).rowwise().mean();
    const double share = 1 / static_cast<double>(skin.size());
    for (const std::int32_t v : skin) {
      const Eigen::Index row = 3 * static_cast<Eigen::Index>(place[static_cast<std::size_t>(v)]);
      const Eigen::Vector3d arm = generic_surface.col(v) - middle;
      out.block<3, 3>(row, 0) = share * Eigen::Matrix3d::Identity();
      out.block<3, 3>(row, 3) = share * cross_matrix(arm);
      out.block<3, 1>(row, 6) = share * arm;
    }
    return out;
  }

  bool factorise(const Sums& sums) {
    const auto n = static_cast<Eigen::Index>(free.size());
    std::vector<Eigen::Triplet<double>> entries;
    entries.reserve(static_cast<std::size_t>(3 * anchor.nonZeros() + 9 * n));
    for (Eigen::Index column = 0; column < anchor.outerSize(); ++column) {
      for (Sparse::InnerIterator entry(anchor, column); entry; ++entry) {
        for (int axis = 0; axis < 3; ++axis) {
          entries.emplace_back(3 * entry.row() + axis, 3 * entry.col() + axis, entry.value());
        }
      }
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) {
          entries.emplace_back(3 * i + a, 3 * i + b, sums.vertex[static_cast<std::size_t>(i)](a, b));
        }
      }
    }
    Sparse matrix(3 * n, 3 * n);
    matrix.setFromTriplets(entries.begin(), entries.end());
    if (!analysed) {
      factor.analyzePattern(matrix);
      analysed = true;
    }
    factor.factorize(matrix);
    return factor.info() == Eigen::Success;
  }

  /// One Gauss-Newton step; false where there is none.
  bool step(bool shape, bool first) {
    const Sums sums = sum_up(first);
    const auto modes_count = static_cast<Eigen::Index>(surface_modes.size());
    const Eigen::Index count = sums.shared.rows();
    Eigen::MatrixXd reduced = sums.shared;
    Eigen::VectorXd gradient = sums.shared_gradient;
    Eigen::MatrixXd eliminated;
    Eigen::VectorXd own;
    if (shape) {
      if (!factorise(sums)) {
        return false;
      }
      eliminated = factor.solve(sums.coupling);
      own = factor.solve(sums.vertex_gradient);
      reduced.noalias() -= sums.coupling.transpose() * eliminated;
      gradient.noalias() -= sums.coupling.transpose() * own;
    } else {
      hold(0, modes_count, reduced, gradient);
    }
    if (!shape || focal_is_known) {
      hold(count - 1, count, reduced, gradient);
    }
    reduced.diagonal() *= 1 + kDamping;
    const Eigen::VectorXd change = -maths::solve_symmetric(reduced, gradient);
    if (!change.allFinite()) {
      return false;
    }
    if (shape) {
      const Eigen::VectorXd moved = -(own + eliminated * change);
      if (!moved.allFinite()) {
        return false;
      }
      delta += Eigen::Map<const Eigen::Matrix3Xd>(moved.data(), 3, static_cast<Eigen::Index>(free.size()));
      identity += change.head(modes_count);
    }
    Eigen::Index at = modes_count;
    for (std::size_t k = 0; k < heads.size(); ++k) {
      if (solves[k] != 0) {
        heads[k].rotation = turned(change.segment<3>(at), heads[k].rotation);
        heads[k].translation_mm += change.segment<3>(at + 3);
        at += 6;
      }
    }
    focal_px *= std::exp(std::clamp(change[count - 1], -0.1, 0.1));
    return true;
  }

  static void hold(Eigen::Index from, Eigen::Index end, Eigen::MatrixXd& matrix, Eigen::VectorXd& gradient) {
    for (Eigen::Index i = from; i < end; ++i) {
      matrix.row(i).setZero();
      matrix.col(i).setZero();
      matrix(i, i) = 1;
      gradient[i] = 0;
    }
  }
};

ShapeSolver::ShapeSolver(const face::FaceModel& model, const std::vector<float>& identity, double focal_px,
                         const Eigen::Vector2d& centre_px, bool focal_is_known,
                         const AnchorStrength& strength)
    : impl_(std::make_unique<Impl>(model, identity, focal_px, centre_px, focal_is_known, strength)) {}

ShapeSolver::~ShapeSolver() = default;

void ShapeSolver::set_points(std::vector<SkinPoints> points, const std::vector<char>& solves) {
  impl_->points = std::move(points);
  impl_->solves = solves;
}

std::vector<HeadState>& ShapeSolver::heads() {
  return impl_->heads;
}
const std::vector<HeadState>& ShapeSolver::heads() const {
  return impl_->heads;
}

bool ShapeSolver::bundle(int steps, bool shape, bool first) {
  for (int i = 0; i < steps; ++i) {
    if (!impl_->step(shape, first)) {
      return false;
    }
  }
  return true;
}

void ShapeSolver::resect(std::size_t keyframe, int steps, const Eigen::VectorXd* prior) {
  Impl& impl = *impl_;
  HeadState& head = impl.heads[keyframe];
  const auto expressions = static_cast<Eigen::Index>(prior != nullptr ? impl.surface_deltas.size() : 0);
  const Eigen::Index count = 6 + expressions;
  const Eigen::Matrix3Xd neutral = impl.neutral_surface();
  for (int step = 0; step < steps; ++step) {
    const Eigen::Matrix3Xd shape = impl.surface(neutral, head.expression);
    const std::vector<double> weight = impl.weights(shape, keyframe);
    Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(count, count);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(count);
    Eigen::Matrix<double, 2, Eigen::Dynamic> row(2, count);
    double sum = 0;
    std::size_t used = 0;
    for (std::size_t i = 0; i < impl.skin.size(); ++i) {
      const std::int32_t v = impl.skin[i];
      if (impl.points[keyframe].confidence[static_cast<std::size_t>(v)] < 0.02F) {
        continue;
      }
      ++used;
      const Linearised line = impl.linearise(shape.col(v), head, impl.points[keyframe].measured_px.col(v));
      row.leftCols<6>() = line.by_pose;
      for (Eigen::Index e = 0; e < expressions; ++e) {
        row.col(6 + e) = line.by_vertex * impl.surface_deltas[static_cast<std::size_t>(e)].col(v);
      }
      matrix.noalias() += weight[i] * row.transpose() * row;
      gradient.noalias() += weight[i] * row.transpose() * line.residual;
      sum += weight[i];
    }
    if (used < kLeastPoints) {
      return;
    }
    if (prior != nullptr) {
      // A face's points are as many facts as it has ways to differ, however many vertices there are.
      const double information = sum / impl.strength.expression_facts /
                                 (impl.strength.expression_sigma * impl.strength.expression_sigma);
      matrix.diagonal().tail(expressions).array() += information;
      gradient.tail(expressions) += information * (head.expression - *prior);
    }
    matrix.diagonal().head<6>() *= 1 + kDamping;
    const Eigen::VectorXd change = -maths::solve_symmetric(matrix, gradient);
    if (!change.allFinite()) {
      return;
    }
    head.rotation = turned(change.head<3>(), head.rotation);
    head.translation_mm += change.segment<3>(3);
    if (prior != nullptr) {
      head.expression = (head.expression + change.tail(expressions)).cwiseMax(0).cwiseMin(1);
    }
  }
}

void ShapeSolver::use_generic(bool generic) {
  impl_->generic = generic;
}

Eigen::Matrix3Xd ShapeSolver::surface(const Eigen::VectorXd& expression) const {
  return impl_->surface(impl_->neutral_surface(), expression);
}

Eigen::VectorXd ShapeSolver::residuals_px(std::size_t keyframe) const {
  const Impl& impl = *impl_;
  Eigen::VectorXd out =
      Eigen::VectorXd::Constant(impl.model.vertex_count(), std::numeric_limits<double>::quiet_NaN());
  const Eigen::Matrix3Xd shape = surface(impl.heads[keyframe].expression);
  for (const std::int32_t v : impl.skin) {
    if (impl.points[keyframe].confidence[static_cast<std::size_t>(v)] > kCounts) {
      out[v] = impl.distance_px(shape, keyframe, v);
    }
  }
  return out;
}

double ShapeSolver::residual_px(std::size_t keyframe) const {
  const Eigen::VectorXd all = residuals_px(keyframe);
  std::vector<double> counted;
  std::copy_if(all.begin(), all.end(), std::back_inserter(counted),
               [](double r) { return std::isfinite(r); });
  return counted.size() > kLeastPoints ? maths::median_of(counted) : std::numeric_limits<double>::quiet_NaN();
}

void ShapeSolver::measure_noise() {
  std::vector<double> medians;
  for (std::size_t k = 0; k < impl_->heads.size(); ++k) {
    if (const double median = residual_px(k); impl_->solves[k] != 0 && std::isfinite(median)) {
      medians.push_back(median);
    }
  }
  if (!medians.empty()) {
    impl_->noise_px = std::clamp(kMadToSigma * maths::median_of(medians) / kMedianOfTwo, 0.2, 1.0);
  }
}

void ShapeSolver::set_least_bound_px(double bound) {
  impl_->least_bound_px = bound;
}
double ShapeSolver::noise_px() const {
  return impl_->noise_px;
}
double ShapeSolver::focal_px() const {
  return impl_->focal();
}
double ShapeSolver::generic_focal_px() const {
  return impl_->generic_focal_px;
}
const Eigen::Matrix3Xd& ShapeSolver::generic_control() const {
  return impl_->generic_control;
}
const std::vector<std::int32_t>& ShapeSolver::skin() const {
  return impl_->skin;
}

Eigen::Matrix3Xd ShapeSolver::control() const {
  const Impl& impl = *impl_;
  Eigen::Matrix3Xd out = impl.generic_control;
  for (std::size_t i = 0; i < impl.modes.size(); ++i) {
    out += impl.identity[static_cast<Eigen::Index>(i)] * impl.modes[i];
  }
  Eigen::Matrix3Xd on_surface = Eigen::Matrix3Xd::Zero(3, out.cols());
  for (std::size_t i = 0; i < impl.free.size(); ++i) {
    on_surface.col(impl.free[i]) = impl.delta.col(static_cast<Eigen::Index>(i));
  }
  // What the control vertices must move by so that the surface moves by delta: delta is smooth, and
  // subdivision takes little of it away; three rounds of putting that back suffice.
  Eigen::Matrix3Xd moved = on_surface;
  for (int round = 0; round < 3; ++round) {
    moved += on_surface - impl.on_surface(moved);
  }
  for (std::size_t v = 0; v < impl.place.size(); ++v) {
    if (impl.place[v] < 0) {
      moved.col(static_cast<Eigen::Index>(v)).setZero();
    }
  }
  return out + moved;
}

Eigen::Matrix3Xd ShapeSolver::control_in_gauge() const {
  const Impl& impl = *impl_;
  const Eigen::Matrix3Xd found = control();
  Eigen::Matrix3Xf from(3, static_cast<Eigen::Index>(impl.skin.size()));
  Eigen::Matrix3Xf to(3, from.cols());
  for (std::size_t i = 0; i < impl.skin.size(); ++i) {
    from.col(static_cast<Eigen::Index>(i)) = found.col(impl.skin[i]).cast<float>();
    to.col(static_cast<Eigen::Index>(i)) = impl.generic_control_f.col(impl.skin[i]);
  }
  return maths::best_similarity(from, to, true).apply(found.cast<float>()).cast<double>();
}

double ShapeSolver::identity_distance() const {
  return impl_->identity.size() == 0
             ? 0
             : impl_->identity.norm() / std::sqrt(static_cast<double>(impl_->identity.size()));
}

double ShapeSolver::offset_mm() const {
  std::vector<double> lengths;
  for (const std::int32_t v : impl_->skin) {
    lengths.push_back(impl_->delta.col(impl_->place[static_cast<std::size_t>(v)]).norm());
  }
  return lengths.empty() ? 0 : maths::quantile_of(lengths, 0.95);
}

Eigen::VectorXd ShapeSolver::uncertainty_mm(const std::function<bool()>& go_on) {
  Impl& impl = *impl_;
  Eigen::VectorXd out =
      Eigen::VectorXd::Constant(impl.model.vertex_count(), std::numeric_limits<double>::quiet_NaN());
  const Impl::Sums sums = impl.sum_up(false);
  if (!impl.factorise(sums)) {
    return out;
  }
  const Eigen::MatrixXd eliminated = impl.factor.solve(sums.coupling);
  Eigen::MatrixXd reduced = sums.shared - sums.coupling.transpose() * eliminated;
  const Eigen::Index count = reduced.rows();
  if (impl.focal_is_known) {
    Eigen::VectorXd unused = Eigen::VectorXd::Zero(count);
    Impl::hold(count - 1, count, reduced, unused);
  }
  const Eigen::MatrixXd covariance = reduced.llt().solve(Eigen::MatrixXd::Identity(count, count));
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(control().cast<float>(), mesh::split_quads(impl.model.control.quads), normals);
  // Of a functional of the surface's points: what of it the shared unknowns answer for, the vertices' own
  // answer taken out.
  const auto by_shared = [&](const Eigen::MatrixXd& functional) -> Eigen::MatrixXd {
    Eigen::MatrixXd out_of = -(eliminated.transpose() * functional);
    for (std::size_t m = 0; m < impl.surface_modes.size(); ++m) {
      for (std::size_t i = 0; i < impl.free.size(); ++i) {
        out_of.row(static_cast<Eigen::Index>(m)) +=
            impl.surface_modes[m].col(impl.free[i]).transpose() *
            functional.middleRows<3>(3 * static_cast<Eigen::Index>(i));
      }
    }
    return out_of;
  };
  // The head's place, turn and size are no one's to know: the uncertainty is that of the shape with these
  // held.
  const Eigen::MatrixXd gauge = impl.gauge_functionals();
  const Eigen::MatrixXd gauge_solved = impl.factor.solve(gauge);
  const Eigen::MatrixXd gauge_shared = covariance * by_shared(gauge);
  const Eigen::MatrixXd gauge_covariance =
      gauge.transpose() * gauge_solved + by_shared(gauge).transpose() * gauge_shared;
  const Eigen::LLT<Eigen::MatrixXd> gauge_factor(gauge_covariance);
  constexpr std::size_t kEvery = 4;
  std::vector<std::int32_t> known;
  Eigen::MatrixXd along = Eigen::MatrixXd::Zero(3 * static_cast<Eigen::Index>(impl.free.size()), 1);
  for (std::size_t i = 0; i < impl.skin.size() && go_on(); i += kEvery) {
    const std::int32_t v = impl.skin[i];
    known.push_back(v);
    const Eigen::Index row = 3 * static_cast<Eigen::Index>(impl.place[static_cast<std::size_t>(v)]);
    const Eigen::Vector3d normal = normals.col(v).cast<double>();
    along.block<3, 1>(row, 0) = normal;
    const Eigen::MatrixXd shared = by_shared(along);
    const double own = normal.dot(impl.factor.solve(along).block<3, 1>(row, 0));
    const Eigen::VectorXd with_gauge =
        (gauge_solved.middleRows<3>(row).transpose() * normal) + gauge_shared.transpose() * shared;
    const double variance = own + (shared.transpose() * covariance * shared)(0, 0) -
                            with_gauge.dot(gauge_factor.solve(with_gauge));
    out[v] = kSharedErrors * std::sqrt(std::max(variance, 0.0));
    along.block<3, 1>(row, 0).setZero();
  }
  // It changes slowly over the skin: what was not solved for is as uncertain as its nearest.
  for (const std::int32_t v : impl.skin) {
    if (std::isnan(out[v]) && !known.empty()) {
      out[v] = out[*std::min_element(known.begin(), known.end(), [&](std::int32_t a, std::int32_t b) {
        return (impl.generic_control.col(a) - impl.generic_control.col(v)).squaredNorm() <
               (impl.generic_control.col(b) - impl.generic_control.col(v)).squaredNorm();
      })];
    }
  }
  return out;
}

}  // namespace facet::person
