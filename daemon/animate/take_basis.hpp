#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "animate/basis_file.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::animate {

struct BasisOptions {
  int coarse_rank = 48;  ///< directions of the control vertices, 1 to kMaxRank; fewer where there are no more
  int detail_rank = 32;  ///< directions of the displacements, 0 to kMaxRank
  /// Where the basis is kept; empty: NAME.basis beside NAME.take. A place that can't be written is no error:
  /// the basis then lives in memory and is made anew the next time.
  std::filesystem::path file;
};

/// Called now and then with frames done and frames to do (each is read twice). Returns false to give up.
using BasisProgress = std::function<bool(std::int64_t done, std::int64_t total)>;

/// A take in few numbers per frame: coefficients of the strongest directions of its control vertices (head
/// frame; the pose of the head is kept apart) and of its displacements, the rigid motion of each eyeball, and
/// the expression weights. Everything that edits or animates works on these. The coefficients of a frame, in
/// their order:
///
///   coarse      [coarse_rank]       control vertices = coarse_mean + coarse directions * coefficients, mm
///   detail      [detail_rank]       displacements = detail_mean + detail directions * coefficients, mm
///   eyes        [eye_count][6]      rotation vector, rad, and shift of the middle, mm; minus eye_means
///   expression  [expression_count]  minus expression_means
///
/// Each coefficient has the mean 0 over all frames. An eyeball is a piece of the control mesh that is joined
/// to no other and lies wholly in the face model's eye region. It moves as a rigid body; in the coarse
/// directions its vertices have zeros. Immutable; any thread.
class TakeBasis {
 public:
  /// The basis of a take. The kept one is read where it was made with these options and of the take as it is
  /// now. Otherwise a basis is made, for which the take is read twice, in blocks of frames, and kept where
  /// the options say.
  ///
  /// errors  Error(UnreadableInput) where the take can't be read, has fewer than 3 meshes or meshes of more
  ///         than one topology, or changes while it is read; Error(Usage) where the options make no sense;
  ///         Error(Unavailable) where progress returned false
  static std::shared_ptr<const TakeBasis> open(const std::filesystem::path& take,
                                               const BasisOptions& options = {},
                                               const BasisProgress& progress = {});

  /// Throws Error(UnreadableInput) where the take's file is no longer what the basis was made of.
  void check_unchanged() const;

  const std::filesystem::path& take() const { return take_; }
  const BasisHeader& header() const { return *sections_.header; }
  bool was_kept() const { return was_kept_; }  ///< open() found it and did not have to make it

  int frame_count() const { return header().frame_count; }
  int coarse_rank() const { return header().coarse_rank; }
  int detail_rank() const { return header().detail_rank; }
  int eye_count() const { return header().eye_count; }
  int expression_count() const { return header().expression_count; }
  int eye_offset() const { return coarse_rank() + detail_rank(); }
  int expression_offset() const { return eye_offset() + 6 * eye_count(); }
  int coefficient_count() const { return expression_offset() + expression_count(); }
  int control_count() const { return header().control_vertex_count; }
  int finest_count() const { return header().finest_vertex_count; }

  using MatrixView = Eigen::Map<const Eigen::MatrixXf>;
  using VectorView = Eigen::Map<const Eigen::VectorXf>;
  MatrixView coefficients() const { return {sections_.coefficients, coefficient_count(), frame_count()}; }
  /// One column per number of the control vertices (x y z x y z ...). [coarse_rank][3 * control_count]
  MatrixView coarse() const { return {sections_.coarse, coarse_rank(), 3 * control_count()}; }
  MatrixView detail() const { return {sections_.detail, detail_rank(), finest_count()}; }
  /// Detail without what is broader than kFoldWidth_mm: the folds. [detail_rank][finest_count]
  MatrixView folds() const { return {sections_.folds, detail_rank(), finest_count()}; }
  VectorView coarse_mean() const { return {sections_.coarse_mean, 3 * control_count()}; }
  VectorView detail_mean() const { return {sections_.detail_mean, finest_count()}; }
  VectorView eye_means() const { return {sections_.eye_means, 6 * eye_count()}; }
  VectorView expression_means() const { return {sections_.expression_means, expression_count()}; }
  /// 0, or 1 + the eyeball that a control vertex belongs to. [control_count]
  std::span<const std::uint8_t> eye_of_vertex() const {
    return {sections_.eye_of_vertex, static_cast<std::size_t>(control_count())};
  }
  std::span<const CapturedFrame> frames() const {
    return {sections_.frames, static_cast<std::size_t>(frame_count())};
  }
  double frame_period_s() const { return header().frame_period_s; }

  /// A frame from the middle of the take. The meshes that are made from this take have its topology, camera,
  /// albedo, lighting and confidence.
  const mesh::MeshFrame& sample() const { return *sample_; }
  const mesh::Hierarchy& hierarchy() const { return *sample_->subject->hierarchy; }
  /// The mean face at the finest level, without displacements, mm. [3][finest_count]
  const mesh::Vertices& rest_mm() const { return rest_mm_; }
  /// The control vertices whose weighted sum is the place of a finest vertex (without its displacement), as
  /// pairs of control vertex and weight. The weights sum to 1.
  std::vector<std::pair<std::int32_t, float>> stencil(std::int32_t finest_vertex) const;

 private:
  TakeBasis(std::filesystem::path take, BasisBytes memory, bool was_kept,
            std::shared_ptr<const mesh::MeshFrame> sample);

  std::filesystem::path take_;
  BasisBytes memory_;
  BasisSections sections_;
  bool was_kept_;
  std::shared_ptr<const mesh::MeshFrame> sample_;
  mesh::Vertices rest_mm_;
};

/// Standard deviation of the smoothing that parts folds from the broader detail, mm: wrinkles are 2 to 6 mm
/// wide.
inline constexpr float kFoldWidth_mm = 3.0F;

/// Takes out of every row what is broader than kFoldWidth_mm: values minus their diffusion over the mesh.
/// values [any][vertex_count] of the finest level; rest_mm [3][vertex_count].
Eigen::MatrixXf narrow_part(const mesh::Hierarchy& hierarchy, const mesh::Vertices& rest_mm,
                            const Eigen::Ref<const Eigen::MatrixXf>& values);

}  // namespace facet::animate
