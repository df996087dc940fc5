#pragma once

#include <Eigen/Core>
#include <Eigen/SparseCholesky>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "landmark/landmarker.hpp"
#include "track/identity_fit.hpp"
#include "track/person.hpp"

namespace facet::track {

/// What the shading of the face tells of who it is. Landmarks say little of cheeks, forehead and chin, and
/// their nets err by 1 to 2 mm, towards the mean face; pictures of the same frames show the normals there:
///   E = sum_frames sum_vertices weight |I - (l_f . SH(n)) rho|^2    [MD19 eq. 1, 2]
/// over the control vertices of the face skin, with a light l_f for every frame and one albedo rho that may
/// leave the model's mean albedo slowly over the face [MD19 eq. 4]. Light, albedo and Tukey's weights are
/// solved in turns, then the energy is linearised by the identity, with poses and expressions held:
/// Gauss-Newton, one step for every call of `evidence`. One thread; `add_frame` and `evidence` allocate.
class IdentityShading {
 public:
  /// The model must outlive this.
  explicit IdentityShading(const face::FaceModel& model);

  /// Keeps the face's part of a picture, linear light, at most 128 px wide and high. face: null where it
  /// shows none; the frame is then counted and not looked at.
  void add_frame(const Frame& image, const landmark::FaceLandmarks* face);
  int frame_count() const { return static_cast<int>(frames_.size()); }

  /// shape and states: the fit so far; states [frame_count]. At most kFramesUsed frames are looked at,
  /// spread over all. Empty where too little of the face is seen to tell anything.
  std::optional<IdentityEvidence> evidence(const SubjectShape& shape, const Eigen::Vector2d& centre_px,
                                           std::span<const FrameState* const> states);

  /// Of the last evidence: rms of I - R over the vertices, relative to the face's rms brightness.
  double residual() const { return residual_; }

  static constexpr int kFramesUsed = 6;

 private:
  using Light = Eigen::Matrix<double, 9, 1>;

  struct Picture {
    int width = 0;
    int height = 0;
    double px_per_source_px = 1;
    Eigen::Vector2d source_origin_px{0, 0};    ///< the source's place of this picture's first pixel's corner
    std::vector<std::array<float, 4>> pixels;  ///< [height][width] linear RGB, share that is not saturated
  };
  struct LookedAt {
    Picture picture;
    std::optional<Light> light;
    Eigen::VectorXd trust;  ///< [data vertex] Tukey's weight
  };
  /// One frame at one shape.
  struct Observed {
    Eigen::Matrix3Xd colours;  ///< [3][data vertex]
    Eigen::VectorXd weights;   ///< [data vertex] 0 to 1: facing, inside, not saturated
    Eigen::Matrix3Xd normals;  ///< [3][data vertex] camera frame, towards the camera, unit
    Eigen::VectorXd lengths;   ///< [data vertex] of the normals before they were made unit
    double sign = 1;           ///< of the quads' orientation
  };

  void contract(const Eigen::VectorXd& expression);
  void observe(const LookedAt& frame, const SubjectShape& shape, const Eigen::Vector2d& centre_px,
               const Pose& pose, Observed& out) const;
  void solve_light(LookedAt& frame, const Observed& seen) const;
  bool solve_albedo(std::span<const Observed> seen, std::span<LookedAt* const> frames);
  void renew_trust(LookedAt& frame, const Observed& seen, double brightness) const;
  double linearise(const LookedAt& frame, const Observed& seen, const Pose& pose, double brightness,
                   IdentityEvidence& out);

  const face::FaceModel* model_;
  std::vector<std::int32_t> support_;               ///< control vertices that the data vertices' quads use
  std::vector<std::int32_t> data_;                  ///< [data vertex] index into support_
  std::vector<std::array<std::int32_t, 4>> quads_;  ///< of indices into support_
  std::vector<std::array<std::int32_t, 2>> vertex_quads_;  ///< (data vertex, quad), sorted by vertex
  Eigen::Matrix3Xd mean_albedo_;                           ///< [3][data vertex]
  Eigen::SparseMatrix<double> smoothness_;                 ///< L^T L over the data vertices
  Eigen::SparseMatrix<double> albedo_system_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> albedo_solver_;
  bool pattern_known_ = false;

  std::vector<LookedAt> frames_;
  Eigen::Matrix3Xd albedo_;  ///< [3][data vertex]
  Eigen::MatrixXd modes_;    ///< [3 support][identity_count + 1] of one frame's expression, mean first
  Eigen::Matrix3Xd places_;  ///< [3][support] head frame
  double residual_ = 0;
};

}  // namespace facet::track
