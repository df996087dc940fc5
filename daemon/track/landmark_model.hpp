#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "landmark/landmark_layout.hpp"

namespace facet::track {

/// The landmarks of one person: linear in the expression. Head frame, mm.
struct LandmarkBasis {
  Eigen::VectorXd neutral_mm;  ///< [landmark][3]
  /// [landmark][3] how far the net sees the landmarks beside the mesh, whatever the expression (IdentityFit):
  /// part of what is compared with measurements, not of the mesh.
  Eigen::VectorXd bias_mm;
  /// [landmark][3] x [expression_count]
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> deltas_mm;
};

/// The bilinear core at the landmarks that have a place on the model: V_l = C_l x2 w_id x3 w_exp
/// [MD19 sec. 3]. Immutable; any thread.
class LandmarkModel {
 public:
  /// Takes the core of `model` at its anchored landmarks. Throws Error(UnreadableInput) where the model has
  /// too few of them to fit a face (run `facet model build`).
  explicit LandmarkModel(const face::FaceModel& model);

  int count() const { return static_cast<int>(landmarks_.size()); }
  int identity_count() const { return identity_count_; }
  int expression_count() const { return expression_count_; }

  /// Indices into the face mesh, [count]; ascending. The last ones are kRightIris and kLeftIris where the
  /// model has eyeballs that its eyeLook shapes turn.
  std::span<const int> landmarks() const { return landmarks_; }
  /// Position of a face mesh index or an iris in landmarks(), or -1. 0 <= landmark <= kLeftIris.
  int position_of(int landmark) const { return position_of_[static_cast<std::size_t>(landmark)]; }
  /// Whether the irises are among the landmarks, so that the gaze can be measured.
  bool sees_gaze() const {
    return position_of(landmark::kRightIris) >= 0 && position_of(landmark::kLeftIris) >= 0;
  }
  /// Distance of the outer eye corners on the mean face, mm.
  double interocular_mm() const { return interocular_mm_; }

  /// C x2 (1, identity): the landmarks' blend shapes of one person. identity [identity_count]. Resizes
  /// `basis` at its first use only.
  void contract_identity(const Eigen::VectorXd& identity, LandmarkBasis& basis) const;

  /// C x3 (1, expression): how the landmarks move with each identity mode. by_identity_mm
  /// [landmark][3] x [identity_count], row-major; resized at its first use only.
  void contract_expression(
      const Eigen::VectorXd& expression,
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>& by_identity_mm) const;

 private:
  std::vector<int> landmarks_;
  std::vector<int> position_of_;  ///< [kLeftIris + 1]
  int identity_count_ = 0;
  int expression_count_ = 0;
  double interocular_mm_ = 0;
  std::vector<float> core_mm_;  ///< [count][identity_count + 1][3][expression_count + 1]
};

}  // namespace facet::track
