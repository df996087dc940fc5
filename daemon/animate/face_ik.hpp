#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "animate/face_sums.hpp"
#include "animate/influence.hpp"
#include "animate/region_metric.hpp"

namespace facet::animate {

/// Where one vertex shall be.
struct ControlTarget {
  enum class Space : std::uint8_t {
    Head,    ///< target: x y z in the head frame, mm
    Screen,  ///< target: x y in the view's picture, px; z unused
  };
  std::int32_t vertex = 0;  ///< of the finest level
  Space space = Space::Head;
  Eigen::Vector3f target{0, 0, 0};
};

struct IkOptions {
  /// false: every control point has a soft region of its own [SF04 eq. 22]; true: all act on the whole face
  /// at once ([SF04 eq. 15-17] alone), which keeps its correlations and can't decouple what was never apart.
  bool whole = false;
  /// Control points go beyond what was captured. false: they are pulled back to the nearest place of its
  /// convex hull, so that a face stays one.
  bool beyond = false;
  /// Folds come from the captured faces nearest to the pose instead of from the average that the weights
  /// make, in which they wash out.
  bool sharp_folds = true;
  /// Every captured face is weighted by itself, however many they are (FaceSums): to measure the difference.
  bool every_face = false;
};

/// What became of one control point.
struct ControlOutcome {
  bool met = false;   ///< within kMetHead_mm or kMetScreen_px of the target (of where clamping put it)
  float miss = 0;     ///< distance to it, mm or px
  float outside = 0;  ///< how far the target lies outside what the take shows of this vertex, mm or px
  bool clamped = false;
  float nearest_mm = 0;  ///< from the posed region to the nearest captured one, rms over its vertices
  std::int32_t nearest_frame = 0;  ///< that one, index in TakeBasis::frames
};

inline constexpr float kMetHead_mm = 0.05F;
inline constexpr float kMetScreen_px = 0.5F;
/// A control point beyond this much outside the captured range is worth a warning.
inline constexpr float kOutsideTolerance = 0.5F;
/// A region further than this from every captured one (ControlOutcome::nearest_mm) is worth one, too.
inline constexpr float kFarFromCaptured_mm = 5;

/// Poses a face by control points (FaceIK [SF04 sec. 4]).
///
/// Each control point's weights over all captured faces minimise sum phi_f c_f^2, phi_f = 1 + |s_f - p|, with
/// sum c_f s_f = p and sum c_f = 1 [SF04 eq. 15, 16]; on screen p(s_f) [SF04 eq. 18-20]. Their closed form
/// [SF04 eq. 17, 21] is used with the row of ones eliminated: with w_f = 1 / phi_f normalised, m and V the
/// weighted mean and covariance of s_f,
///   c_f = w_f (1 + (s_f - m)^T V^-1 (p - m)),
/// a weighted linear regression of faces on control points. The sum is 1 whatever V is, so that a singular V
/// (vertices that never move, fewer faces than numbers) can be regularised. Regions are blended by influence
/// maps [SF04 eq. 22]. What the reduced basis, the displacements along turning normals and regularisation
/// leave of a miss, a few Gauss-Newton steps on p take away.
///
/// One thread. solve() with control points of the same vertices as before allocates little and takes
/// milliseconds; with others it computes their influence maps and metrics first (tenths of a second).
class FaceIk {
 public:
  explicit FaceIk(std::shared_ptr<const TakeBasis> basis, IkOptions options = {});
  ~FaceIk();
  FaceIk(const FaceIk&) = delete;
  FaceIk& operator=(const FaceIk&) = delete;

  /// What screen-space targets refer to.
  void set_view(const CameraIntrinsics& camera, const Eigen::Isometry3f& camera_from_head);
  void set_options(IkOptions options);

  /// What solve() throws for these targets, without solving. Any thread while nobody calls set_view.
  void check(std::span<const ControlTarget> targets) const;

  /// The pose for these control points; none: the mean face. Outcomes in the order of targets, valid until
  /// the next call. Throws Error(Usage), and leaves pose and state as they were, where a target is not
  /// finite or further than kFarthest_mm (kFarthest_px) from the resting vertex, a vertex is not on the mesh
  /// or named twice, or a screen target has no view or is behind its camera; Error(UnreadableInput) where
  /// the take changed on disk (looked at when the vertices change).
  const std::vector<ControlOutcome>& solve(std::span<const ControlTarget> targets, Pose& pose);

  /// Each region's weights of the last solve over the captured faces, chat of [SF04 eq. 22]: sums of columns
  /// are 1. For tests and pictures. [frame_count][region_count]
  Eigen::MatrixXd region_weights() const;

  const TakeBasis& basis() const { return *basis_; }

  static constexpr float kFarthest_mm = 1000;
  static constexpr float kFarthest_px = 100'000;

 private:
  struct Site;
  struct Group;
  struct Region;
  void rebuild(std::span<const ControlTarget> targets);
  void build_site(Site& site) const;
  Eigen::MatrixXd captured(const Group& group) const;
  void solve_group(Group& group);
  void blend_regions(Pose& pose) const;
  void pick_folds(Pose& pose);
  /// Where a site's vertex is in a pose, head frame.
  Eigen::Vector3f position(const Site& site, const Eigen::MatrixXf& state) const;
  Eigen::VectorXd measure(const Pose& pose, Eigen::Index size, bool& good);
  Eigen::MatrixXd jacobian(Eigen::Index size) const;
  void correct(Pose& pose);
  void report(const Pose& pose);
  Eigen::Vector2d project(const Eigen::Vector3d& head_mm) const;
  /// A point in the numbers of a site's target: x y z, or x y on screen.
  Eigen::VectorXd as_targeted(const Site& site, const Eigen::Vector3d& head_mm) const;

  std::shared_ptr<const TakeBasis> basis_;
  IkOptions options_;
  bool has_view_ = false;
  CameraIntrinsics camera_;
  Eigen::Isometry3f camera_from_head_ = Eigen::Isometry3f::Identity();

  std::vector<Eigen::Index> exemplars_;  ///< frames that stand for all where nearness is asked for
  std::shared_ptr<const InfluenceMaps> maps_;
  std::vector<Site> sites_;
  std::vector<Group> groups_;  ///< one per region
  std::vector<Region> regions_;
  Eigen::MatrixXd region_from_group_;  ///< [region_count][group_count] inverse of the influences at the sites
  std::vector<ControlOutcome> outcomes_;
};

/// Frames spread over all faces so that each is near one of them: all where there are no more than `most`,
/// else farthest-point sampling [Gon85]. coordinates [any][frame_count]
std::vector<Eigen::Index> spread_frames(const Eigen::MatrixXf& coordinates, Eigen::Index most);

}  // namespace facet::animate
