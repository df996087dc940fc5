#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

namespace facet::track {

/// Strengths of the expression prior's parts. Found by experiment: docs/decisions/tracking-weights.md.
struct ExpressionPriorStrength {
  double size = 1.0;       ///< of (e / sigma)^2
  double sparsity = 1.5;   ///< of |e| / sigma: few shapes rather than many small ones
  double symmetry = 1.0;   ///< of ((left - right) / kSymmetrySigma)^2
  double exclusion = 4.0;  ///< of (a b / (sigma_a sigma_b))^2 for shapes that undo each other
};

/// What is known of an expression before the landmarks are seen:
///   E = sum_k size/2 (e_k / s_k)^2 + sparsity e_k / s_k + symmetry/2 sum ((e_left - e_right) / sigma)^2
///     + exclusion/2 sum_{a,b opposed} (e_a e_b / (s_a s_b))^2 + 1/2 (max(0, mouthClose - jawOpen) / sigma)^2
/// for e >= 0, where |e| = e is smooth. Pairs are found by their ARKit names; a model without them has no
/// such terms. Immutable; any thread.
class ExpressionPrior {
 public:
  /// names and sigma as in face::FaceModel; a sigma below 0.02 is taken as 0.02, and so are the eyeLook
  /// shapes where no landmark shows the gaze (LandmarkModel::sees_gaze): they then stay near 0.
  ExpressionPrior(std::span<const std::string> names, std::span<const float> sigma,
                  const ExpressionPriorStrength& strength, bool sees_gaze);

  /// expression [expression_count], each in [0, 1].
  double energy(const Eigen::VectorXd& expression) const;

  /// Adds the Gauss-Newton matrix and the gradient of the energy; the expressions are the unknowns from `at`
  /// on.
  void add(const Eigen::VectorXd& expression, int at, Eigen::MatrixXd& hessian,
           Eigen::VectorXd& gradient) const;

  const Eigen::VectorXd& sigma() const { return sigma_; }

 private:
  std::optional<int> find(std::span<const std::string> names, const std::string& name) const;

  ExpressionPriorStrength strength_;
  Eigen::VectorXd sigma_;                      ///< [expression_count]
  std::vector<std::pair<int, int>> mirrored_;  ///< left and right of one shape
  std::vector<std::pair<int, int>> opposed_;   ///< shapes that undo each other
  std::optional<std::pair<int, int>> mouth_close_and_jaw_open_;
};

}  // namespace facet::track
