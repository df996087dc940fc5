#include "fit/first_shape.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace facet::fit {
namespace {

using Eigen::Index;
using Eigen::Matrix3Xd;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Eigen::VectorXf;

constexpr int kRounds = 24;
constexpr int kSweeps = 60;      ///< over all coefficients in a round
constexpr double kNoise_mm = 2;  ///< of a landmark in space, typically
/// Cauchy's: from there on a landmark counts half and less. It shrinks from round to round, since a mouth
/// that is wide open is far off until the model has opened its own.
constexpr double kFarOffAtFirst_mm = 30;
constexpr double kFarOff_mm = 4;
constexpr double kShrinks = 0.85;
constexpr double kMostIdentity = 3;  ///< standard deviations
constexpr double kJawMoves_mm = 2;
constexpr double kLeastSigma = 0.05;

/// What the coefficients move: [3 * correspondence_count][identity_count + expression_count] at the mean
/// person's landmarks, and these.
struct Landmarks {
  Landmarks(const face::FaceModel& model, std::span<const Correspondence> correspondences)
      : basis(3 * static_cast<Index>(correspondences.size()),
              model.identity_count() + model.expression_count()),
        mean_mm(3, static_cast<Index>(correspondences.size())),
        target_mm(3, static_cast<Index>(correspondences.size())) {
    for (Index i = 0; i < mean_mm.cols(); ++i) {
      const Correspondence& one = correspondences[static_cast<std::size_t>(i)];
      const auto at = [&](int identity_mode, int expression_mode) {
        return face::FaceModel::anchor_point(one.anchor, model.core_row(identity_mode, expression_mode))
            .cast<double>()
            .eval();
      };
      mean_mm.col(i) = at(0, 0);
      target_mm.col(i) = one.target_mm;
      for (int k = 0; k < model.identity_count(); ++k) {
        basis.block<3, 1>(3 * i, k) = at(k + 1, 0);
      }
      for (int k = 0; k < model.expression_count(); ++k) {
        basis.block<3, 1>(3 * i, model.identity_count() + k) = at(0, k + 1);
      }
    }
  }

  MatrixXd basis;
  Matrix3Xd mean_mm;
  Matrix3Xd target_mm;
};

/// Where a face has its coefficients.
struct Bounds {
  VectorXd least, most;
};

/// One ridge solve by projected Gauss-Seidel, which keeps every coefficient within its bounds.
void solve(const MatrixXd& left, const VectorXd& right, const Bounds& bounds, VectorXd& coefficients) {
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (Index k = 0; k < coefficients.size(); ++k) {
      const double value = coefficients[k] + (right[k] - left.row(k).dot(coefficients)) / left(k, k);
      coefficients[k] = std::clamp(value, bounds.least[k], bounds.most[k]);
    }
  }
}

/// Of "jawOpen" among the model's expressions.
std::optional<Index> jaw_of(const face::FaceModel& model) {
  const auto at = std::find(model.expression_names.begin(), model.expression_names.end(), "jawOpen");
  return at == model.expression_names.end() ? std::nullopt
                                            : std::optional<Index>(at - model.expression_names.begin());
}

}  // namespace

FirstShape mean_shape(const face::FaceModel& model) {
  FirstShape shape;
  model.evaluate({}, {}, shape.neutral_mm);
  shape.shown_mm = shape.neutral_mm;
  shape.deltas_mm = model.contract_identity({}).deltas_mm;
  shape.expression = VectorXd::Zero(model.expression_count());
  return shape;
}

std::vector<Correspondence> above_the_jaw(const face::FaceModel& model,
                                          std::span<const Correspondence> correspondences) {
  std::vector<Correspondence> out(correspondences.begin(), correspondences.end());
  const std::optional<Index> jaw = jaw_of(model);
  if (!jaw) {
    return out;
  }
  const mesh::Vertices moved_mm = model.core_row(0, static_cast<int>(*jaw) + 1);
  out.erase(std::remove_if(out.begin(), out.end(),
                           [&](const Correspondence& one) {
                             return static_cast<double>(
                                        face::FaceModel::anchor_point(one.anchor, moved_mm).norm()) >
                                    kJawMoves_mm;
                           }),
            out.end());
  return out;
}

FirstShape find_first_shape(const face::FaceModel& model, std::span<const Correspondence> correspondences,
                            std::optional<double> jaw_open) {
  const Landmarks landmarks(model, correspondences);
  const Index count = landmarks.mean_mm.cols();
  const Index identities = model.identity_count();
  VectorXd coefficients = VectorXd::Zero(landmarks.basis.cols());
  VectorXd prior(landmarks.basis.cols());
  prior.head(identities).setOnes();
  for (int k = 0; k < model.expression_count(); ++k) {
    const double sigma =
        std::max<double>(kLeastSigma, model.expression_sigma.at(static_cast<std::size_t>(k)));
    prior[identities + k] = 1 / (sigma * sigma);
  }
  Bounds bounds{VectorXd::Zero(coefficients.size()), VectorXd::Ones(coefficients.size())};
  bounds.least.head(identities).setConstant(-kMostIdentity);
  bounds.most.head(identities).setConstant(kMostIdentity);
  if (const std::optional<Index> jaw = jaw_of(model); jaw && jaw_open) {
    bounds.least[identities + *jaw] = bounds.most[identities + *jaw] = *jaw_open;
    coefficients[identities + *jaw] = *jaw_open;
  }
  VectorXd weights = VectorXd::Ones(count);
  VectorXd row_weights(3 * count);
  for (int round = 0; count > 0 && round < kRounds; ++round) {
    const VectorXd moved = landmarks.basis * coefficients;
    const Matrix3Xd now = landmarks.mean_mm + Eigen::Map<const Matrix3Xd>(moved.data(), 3, count);
    double scale = 1;
    const Eigen::Isometry3d rig_from_head = align_rigidly(now, landmarks.target_mm, weights, &scale);
    const Matrix3Xd target = rig_from_head.linear().transpose() *
                             (landmarks.target_mm.colwise() - rig_from_head.translation()) / scale;
    const double far_mm = std::max(kFarOff_mm, kFarOffAtFirst_mm * std::pow(kShrinks, round));
    weights = ((target - now).colwise().squaredNorm().array() / (far_mm * far_mm) + 1).inverse();
    for (Index i = 0; i < count; ++i) {
      row_weights.segment<3>(3 * i).setConstant(weights[i] / (kNoise_mm * kNoise_mm));
    }
    const Matrix3Xd way = target - landmarks.mean_mm;
    const MatrixXd weighed = row_weights.asDiagonal() * landmarks.basis;
    MatrixXd left = landmarks.basis.transpose() * weighed;
    left.diagonal() += prior;
    solve(left, weighed.transpose() * Eigen::Map<const VectorXd>(way.data(), 3 * count), bounds,
          coefficients);
  }
  const VectorXf identity = coefficients.head(identities).cast<float>();
  const face::ExpressionBasis person =
      model.contract_identity({identity.data(), static_cast<std::size_t>(identities)});
  FirstShape shape;
  shape.expression = coefficients.tail(model.expression_count());
  const VectorXf expression = shape.expression.cast<float>();
  person.evaluate({expression.data(), static_cast<std::size_t>(expression.size())}, shape.shown_mm);
  shape.neutral_mm = person.neutral_mm;
  shape.deltas_mm = person.deltas_mm;
  return shape;
}

}  // namespace facet::fit
