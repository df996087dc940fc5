#include "track/landmark_term.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace facet::track {
namespace {

/// Huber's rho for a squared residual.
double huber_energy(double squared, double threshold) {
  return squared <= threshold * threshold ? 0.5 * squared
                                          : threshold * std::sqrt(squared) - 0.5 * threshold * threshold;
}

/// Square root of Huber's weight: rows and residuals are multiplied by it.
double huber_scale(double squared, double threshold) {
  return squared <= threshold * threshold ? 1.0 : std::sqrt(threshold / std::sqrt(squared));
}

}  // namespace

void apply_step(const FrameState& from, const Eigen::VectorXd& step, FrameState& to) {
  to.pose.rotation = rotation_from_vector(step.segment<3>(kRotationAt)) * from.pose.rotation;
  to.pose.translation_mm = from.pose.translation_mm + step.segment<3>(kTranslationAt);
  const Eigen::Index count = from.expression.size();
  to.expression.resize(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    to.expression[k] = std::clamp(from.expression[k] + step[kExpressionAt + k], 0.0, 1.0);
  }
}

void observe(const LandmarkModel& model, const LandmarkTrust& trust, const landmark::FaceLandmarks& face,
             const Eigen::Vector3d& place_mm, double focal_px, const FitCamera& camera, Observation& out) {
  const auto count = static_cast<std::size_t>(model.count());
  out.points_px.resize(2, model.count());
  out.whitening.resize(count);
  out.camera = camera;
  out.seen = true;

  std::array<int, landmark::kLandmarkGroupCount> members{};
  const auto& groups = landmark::landmark_groups();
  for (const int landmark : model.landmarks()) {
    if (landmark < landmark::landmark_count) {
      ++members[static_cast<std::size_t>(groups[static_cast<std::size_t>(landmark)])];
    }
  }

  const double depth_mm = (camera.view_from_reference * place_mm).z();
  const double px_per_mm = camera.focal_ratio * focal_px / std::max(depth_mm, kNearestDepthMm);
  const double per_sigma = 1.0 / (trust.sigma_mm * px_per_mm);
  for (std::size_t l = 0; l < count; ++l) {
    const int landmark = model.landmarks()[l];
    const double confidence = landmark::confidence_of(face, landmark);
    if (landmark >= landmark::landmark_count) {
      // An iris that is not seen says nothing at all; its place may not even be there.
      constexpr int kIrises = 2;
      out.points_px.col(static_cast<Eigen::Index>(l)) = camera.centre_px;
      if (face.irises_px.cols() == kIrises) {
        out.points_px.col(static_cast<Eigen::Index>(l)) =
            landmark::place_of(face, landmark).head<2>().cast<double>();
      }
      out.whitening[l] =
          Eigen::Matrix2d::Identity() * (std::sqrt(confidence * trust.iris_strength / kIrises) * per_sigma);
      continue;
    }
    out.points_px.col(static_cast<Eigen::Index>(l)) = face.points_px.col(landmark).head<2>().cast<double>();
    const auto group = static_cast<std::size_t>(groups[static_cast<std::size_t>(landmark)]);
    const double seen = trust.unseen + (1.0 - trust.unseen) * confidence;
    const double weight = seen * trust.group_strength[group] / members[group];
    out.whitening[l] = Eigen::Matrix2d::Identity() * (std::sqrt(weight) * per_sigma);
  }

  const auto contour = landmark::contour_landmarks();
  for (std::size_t k = 0; k < contour.size(); ++k) {
    const int l = model.position_of(contour[k]);
    if (l < 0) {
      continue;
    }
    const int next = contour[(k + 1) % contour.size()];
    const int last = contour[(k + contour.size() - 1) % contour.size()];
    const Eigen::Vector2d tangent =
        (face.points_px.col(next) - face.points_px.col(last)).head<2>().cast<double>();
    const double length = tangent.norm();
    if (length > 0) {
      const Eigen::Vector2d along = tangent / length;
      const Eigen::Vector2d across(-along.y(), along.x());
      out.whitening[static_cast<std::size_t>(l)] *=
          across * across.transpose() + std::sqrt(trust.along_contour) * along * along.transpose();
    }
  }
}

void weigh_views(std::span<Observation> views) {
  const auto seen =
      std::count_if(views.begin(), views.end(), [](const Observation& view) { return view.seen; });
  for (Observation& view : views) {
    view.weight = view.seen ? 1.0 / static_cast<double>(seen) : 0.0;
  }
}

LandmarkTerm::LandmarkTerm(const LandmarkModel& model, const LandmarkTrust& trust)
    : huber_sigmas_(trust.huber_sigmas), head_mm_(3 * model.count()), rotated_mm_(3, model.count()) {}

void LandmarkTerm::place(const LandmarkBasis& basis, const FrameState& state, bool with_bias) {
  head_mm_ = basis.neutral_mm;
  if (with_bias) {
    head_mm_ += basis.bias_mm;
  }
  head_mm_.noalias() += basis.deltas_mm * state.expression;
  const Eigen::Index count = rotated_mm_.cols();
  for (Eigen::Index l = 0; l < count; ++l) {
    rotated_mm_.col(l).noalias() = state.pose.rotation * head_mm_.segment<3>(3 * l);
  }
}

bool LandmarkTerm::project_landmark(Eigen::Index l, const FitCamera& camera, double focal_px,
                                    const FrameState& state, Projection& at) const {
  const Eigen::Vector3d reference_mm = rotated_mm_.col(l) + state.pose.translation_mm;
  return project(camera.view_from_reference * reference_mm, camera.focal_ratio * focal_px, camera.centre_px,
                 at);
}

double LandmarkTerm::energy(const LandmarkBasis& basis, const Observation& observation, double focal_px,
                            const FrameState& state) {
  if (!observation.seen) {
    return 0;
  }
  place(basis, state, true);
  double sum = 0;
  for (Eigen::Index l = 0; l < rotated_mm_.cols(); ++l) {
    Projection at;
    if (!project_landmark(l, observation.camera, focal_px, state, at)) {
      return std::numeric_limits<double>::infinity();
    }
    const auto& whitening = observation.whitening[static_cast<std::size_t>(l)];
    const Eigen::Vector2d residual = whitening * (at.px - observation.points_px.col(l));
    sum += huber_energy(residual.squaredNorm(), huber_sigmas_);
  }
  return observation.weight * sum;
}

double LandmarkTerm::linearise(
    const LandmarkBasis& basis, const Observation& observation, double focal_px, const FrameState& state,
    const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>* by_identity_mm,
    NormalEquations& equations) {
  const double total = energy(basis, observation, focal_px, state);
  if (!observation.seen || !std::isfinite(total)) {
    return total;
  }
  const Eigen::Index expressions = state.expression.size();
  const double root_weight = std::sqrt(observation.weight);
  for (Eigen::Index l = 0; l < rotated_mm_.cols(); ++l) {
    const Eigen::Vector3d rotated = rotated_mm_.col(l);
    Projection at;
    project_landmark(l, observation.camera, focal_px, state, at);
    Eigen::Matrix2d whitening = observation.whitening[static_cast<std::size_t>(l)];
    Eigen::Vector2d residual = whitening * (at.px - observation.points_px.col(l));
    const double scale = root_weight * huber_scale(residual.squaredNorm(), huber_sigmas_);
    whitening *= scale;
    residual *= scale;
    const Eigen::Matrix<double, 2, 3> by_camera =
        (whitening * at.by_point) * observation.camera.view_from_reference.linear();
    const Eigen::Matrix<double, 2, 3> by_head = by_camera * state.pose.rotation;
    const Eigen::Matrix<double, 2, 3> by_rotation = -by_camera * cross_matrix(rotated);
    const Eigen::Vector2d by_log_focal = whitening * at.by_log_focal;
    for (int axis = 0; axis < 2; ++axis) {
      double* row = equations.add_row(residual[axis]);
      for (int i = 0; i < 3; ++i) {
        row[kRotationAt + i] = by_rotation(axis, i);
        row[kTranslationAt + i] = by_camera(axis, i);
      }
      const double a = by_head(axis, 0), b = by_head(axis, 1), c = by_head(axis, 2);
      Eigen::Map<Eigen::RowVectorXd>(row + kExpressionAt, expressions) = a * basis.deltas_mm.row(3 * l) +
                                                                         b * basis.deltas_mm.row(3 * l + 1) +
                                                                         c * basis.deltas_mm.row(3 * l + 2);
      if (by_identity_mm != nullptr) {
        double* shared = row + kExpressionAt + expressions;
        Eigen::Map<Eigen::RowVectorXd>(shared, by_identity_mm->cols()) = a * by_identity_mm->row(3 * l) +
                                                                         b * by_identity_mm->row(3 * l + 1) +
                                                                         c * by_identity_mm->row(3 * l + 2);
        shared[by_identity_mm->cols()] = by_log_focal[axis];
      }
    }
  }
  return total;
}

bool LandmarkTerm::residuals_px(const LandmarkBasis& basis, const Observation& observation, double focal_px,
                                const FrameState& state, bool with_bias, Eigen::Matrix2Xd& out) {
  place(basis, state, with_bias);
  out.resize(2, rotated_mm_.cols());
  for (Eigen::Index l = 0; l < rotated_mm_.cols(); ++l) {
    Projection at;
    if (!project_landmark(l, observation.camera, focal_px, state, at)) {
      return false;
    }
    out.col(l) = at.px - observation.points_px.col(l);
  }
  return true;
}

}  // namespace facet::track
