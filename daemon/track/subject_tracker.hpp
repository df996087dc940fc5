#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "facet/frame.hpp"
#include "mesh/mesh_frame.hpp"
#include "track/coarse_fit.hpp"
#include "track/identity_fit.hpp"
#include "track/identity_shading.hpp"
#include "track/person.hpp"

namespace facet::track {

struct SubjectTrackerConfig {
  int acquisition_frames = 15;  ///< frames in the identity batch
  /// Where given, the reference camera's pictures tell of the identity, too (IdentityShading). Must outlive
  /// the tracker.
  const face::FaceModel* shading_model = nullptr;
  std::optional<CameraIntrinsics> intrinsics;  ///< known camera: the focal length is then not estimated
  std::vector<FurtherCamera> further_views{};  ///< beside the camera above, which is then known
  LandmarkTrust trust;
  TemporalPriorStrength temporal;
  IdentityPriorStrength identity;
};

/// What one view shows in a frame.
struct ViewLandmarks {
  const landmark::FaceLandmarks* face = nullptr;  ///< null where none was found
  bool acquired = false;  ///< it was found afresh and may be another one than in the last frame
};

/// The fit of one frame.
struct SubjectFrame {
  mesh::TrackingState state = mesh::TrackingState::Searching;
  /// The frame has a pose and an expression: always in state Tracking, provisional in Acquiring.
  bool fitted = false;
  /// The landmarks were no plausible face for this subject: they should be looked for afresh.
  bool rejected = false;
  /// [view] the same of each: they were no plausible face, or not the one that the other views agree on.
  std::vector<std::uint8_t> view_rejected;
  /// [view] 1 where its landmarks went into the fit.
  std::vector<std::uint8_t> view_used;
  /// The head is turned further than the landmark nets can follow: no mesh in this frame, but it is the same
  /// face, and should be followed on.
  bool beyond_sight = false;
  std::uint32_t subject = 0;        ///< counts identity estimates
  std::uint64_t shape_version = 0;  ///< changes whenever shape().identity does
  FrameState face;
  double reprojection_px = 0;  ///< median distance of the mesh's landmarks from the measured ones
  /// Median landmark residual of the fit as a fraction of the interocular distance, foreshortening undone and
  /// the subject's landmark bias taken out.
  double relative_residual = 0;
  CoarseFitReport fit;
};

/// Turns the landmarks of successive frames into one subject's pose and expression: the tracking states, the
/// identity batch, the gates, and who it is that came back. Knows nothing of images and nets. No allocation
/// in state Tracking. One thread.
///
///   Searching -- plausible face --> Acquiring -- batch fitted --> Tracking
///   Tracking, Acquiring -- no plausible face --> Lost -- face back --> where it was
///   Tracking, Acquiring -- turned too far --> Lost -- turned back --> where it was, without further checks
///   Lost -- kLostForS --> Searching; the subject is kept: when a face comes that fits it, straight to
///   Tracking. When over its first frames a returned face fits the held identity clearly worse than its owner
/// did, the subject is given up and Acquiring starts anew.
///
/// Several views: all landmarks stand in one energy. Where that gives no plausible face, each view is asked
/// alone, the one that most others agree with is believed, and those that contradict it are left out of the
/// frame. Any one view is enough to go on.
class SubjectTracker {
 public:
  SubjectTracker(const LandmarkModel& model, const ExpressionPrior& prior,
                 const SubjectTrackerConfig& config);

  /// The next frame of a sequence. face: null where none was found; acquired: it was found afresh and may be
  /// another one than in the last frame. timestamp_ns: on the source's own clock (Frame::media_time_ns),
  /// never decreasing, so that a result does not depend on how fast frames are worked off. Valid until the
  /// next call.
  const SubjectFrame& process(const landmark::FaceLandmarks* face, bool acquired, int width_px, int height_px,
                              std::int64_t timestamp_ns);

  /// The same for every view, the reference camera first; views that are left out at the end show nothing.
  /// width_px, height_px: of the reference camera's pictures; the others' are those of their intrinsics.
  /// image: the reference camera's, where shading shall tell of the identity, too; else null.
  const SubjectFrame& process(std::span<const ViewLandmarks> views, int width_px, int height_px,
                              std::int64_t timestamp_ns, const Frame* image = nullptr);

  /// Ends the acquisition with the frames gathered so far, for recordings that are shorter than it. False
  /// where there is no frame to go by.
  bool settle();

  /// Forgets identity and focal length; the next plausible face is acquired anew.
  void reset_identity();

  /// Identity and focal length in use; the mean face before the first estimate.
  const SubjectShape& shape() const { return person_.shape; }
  const Person& person() const { return person_; }
  bool has_person() const { return has_subject_; }

  /// Takes over a subject estimated earlier, for example in a first pass over the same recording: tracking
  /// starts with the next plausible face. False, and nothing changed, where the sizes don't fit the model or
  /// a value is not finite.
  bool adopt(const Person& person, int width_px, int height_px);

  CameraIntrinsics camera() const;

  /// Landmarks of the shape in use, with its bias.
  const LandmarkBasis& basis() const { return basis_; }
  const FitCamera& camera_of(std::size_t view) const { return views_[view].camera; }

 private:
  /// One camera and what it shows in this frame.
  struct ViewState {
    FitCamera camera;
    float longer_side_px = 0;
    const landmark::FaceLandmarks* face = nullptr;  ///< null where it shows none that is usable
    double reprojection_px = 0;                     ///< of the mesh, at candidate_
    double residual = 0;                            ///< of the fit, as a fraction of the interocular distance
  };

  bool usable(const landmark::FaceLandmarks& face, float longer_side_px) const;
  void set_image_size(int width_px, int height_px);
  void place_cameras();
  void set_shape();
  bool fit(bool warm, double elapsed_s);
  void keep_agreeing_views(bool warm, double elapsed_s);
  bool fit_used(bool warm, double elapsed_s);
  bool start_pose();
  void observe_view(std::size_t view);
  std::optional<double> median_residual_px(std::size_t view, bool with_bias);
  bool measure_view(std::size_t view);
  bool measure_residual();
  bool plausible(double largest_residual) const;
  Pose pose_in(const FitCamera& camera) const;
  bool jumped(double elapsed_s) const;
  double facing(const ViewState& view) const;
  bool turned() const;
  bool beyond_sight() const;
  void miss(std::int64_t timestamp_ns);
  void accept(bool found_afresh, std::int64_t timestamp_ns);
  bool acquire();
  bool shade();
  void take_identity();
  bool worth_adding() const;
  bool still_the_same_person();
  double fixed_focal_px() const;
  Eigen::Vector2d centre_px() const;

  const LandmarkModel* model_;
  const ExpressionPrior* prior_;
  SubjectTrackerConfig config_;
  CoarseFit coarse_fit_;
  std::optional<IdentityFit> identity_fit_;
  std::optional<IdentityShading> shading_;  ///< of identity_fit_'s frames
  int shading_steps_ = 0;
  const Frame* image_ = nullptr;  ///< of the call of `process` that runs
  Person person_;
  bool has_subject_ = false;
  LandmarkBasis basis_;  ///< of person_, with its landmark bias
  int width_px_ = 0;
  int height_px_ = 0;

  SubjectFrame frame_;
  std::vector<ViewState> views_;                             ///< the reference camera first
  std::vector<Observation> observations_;                    ///< [view]; seen: it is used for this frame
  std::vector<std::uint8_t> agreeing_;                       ///< [view] scratch
  std::vector<const landmark::FaceLandmarks*> batch_faces_;  ///< [view] scratch
  FrameState candidate_;
  double candidate_reprojection_px_ = 0;
  double candidate_residual_ = 0;
  CoarseFitReport candidate_report_;
  TemporalPrior previous_;     ///< the last good frame, where has_previous_
  bool followed_ = false;      ///< no frame since the last good one lacked the face
  bool has_previous_ = false;  ///< false also after the shape changed: the old pose belongs to the old shape
  std::int64_t last_good_ns_ = 0;
  int frames_since_added_ = 0;
  int settling_frames_ = 0;  ///< good frames since the batch is full
  int verified_frames_ = 0;  ///< good frames since the subject came back; kVerifyFrames: it is the same one
  double verified_residual_sum_ = 0;
  int residual_frames_ = 0;  ///< good frames that went into person_.usual_residual
  Eigen::Matrix3Xd start_head_mm_;
  Eigen::Matrix3Xd start_px_;
  Eigen::VectorXd start_weights_;
  Eigen::Matrix2Xd residuals_px_;
  std::vector<double> sorted_;
};

}  // namespace facet::track
