#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "mesh/mesh_frame.hpp"
#include "track/further_camera.hpp"
#include "track/landmark_movements.hpp"
#include "track/person.hpp"

namespace facet::track {

struct TrackerConfig {
  std::filesystem::path landmark_nets;  ///< face_mesh_solution_packed_assets.data
  int acquisition_frames = 15;          ///< good frames over which identity and focal length are estimated
  std::optional<CameraIntrinsics> intrinsics;  ///< known camera: the focal length is then not estimated
  /// Calibrated cameras beside that one, which then is the reference camera and must be known.
  std::vector<FurtherCamera> further_views{};
  bool identity_shading = true;   ///< the pictures' shading tells of the identity, too (IdentityShading)
  float expression_prior = 1.0F;  ///< scales the default weight
  float temporal_prior = 1.0F;    ///< scales the default weight
  /// Frames can't wait (LandmarkerConfig::live); where this is off, a sequence gives the same bits every
  /// time.
  bool live = false;
};

/// The coarse face of one frame.
struct TrackResult {
  mesh::TrackingState state = mesh::TrackingState::Searching;
  /// Pose, expression and vertices_mm belong to this frame: always in state Tracking; in Acquiring they are
  /// provisional, from an identity that still changes.
  bool has_mesh = false;
  std::uint32_t subject = 0;  ///< counts identity estimates; 0 before the first
  CameraIntrinsics camera;
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();
  std::vector<float> identity;    ///< [identity_count]
  std::vector<float> expression;  ///< [expression_count] of the model's shapes, as fitted
  /// [expression_count] 0 to 1: what the face does by ARKit's names, as read off the landmarks; the fitted
  /// ones where nothing is read (another model's names).
  std::vector<float> values;
  std::vector<float> value_confidence;  ///< [expression_count] 0 to 1 of each value; empty: not known
  LandmarkMovements movements;          ///< what they are read off (landmark_movements); valid where has_mesh
  /// [3][vertex_count] head frame; valid where has_mesh.
  mesh::Vertices vertices_mm;
  std::vector<Eigen::Vector2f> landmarks_px;  ///< [468] measured; empty where no face was found
  float reprojection_px = 0;                  ///< median over the landmarks used
  float interocular_px = 0;  ///< distance of the outer eye corners, to scale the figure above
  /// [view] 1 where the view's landmarks went into the fit: the reference camera, then further_views.
  std::vector<std::uint8_t> view_used;
  float detect_ms = 0;
  float landmarks_ms = 0;
  float fit_ms = 0;
};

/// Finds one face and follows it: landmarks (MediaPipe nets), then pose and expression by
/// Levenberg-Marquardt; identity and focal length over the first good frames [MD19 sec. 3].
/// One thread; no allocation after the first tracked frame.
class Tracker {
 public:
  /// Throws Error(UnreadableInput) where the landmark assets are missing or damaged. The model must outlive
  /// the tracker; Error(Usage) where further views come without intrinsics.
  Tracker(const face::FaceModel& model, const TrackerConfig& config);
  ~Tracker();

  /// Never throws; a frame it can't use gives state Searching or Lost. The result is valid until the next
  /// call.
  const TrackResult& process(const Frame& frame);

  /// The same for one picture of each view, exposed at the same moment, the reference camera's first. An
  /// empty or damaged picture, and one of another size than calibrated, shows no face; so do views left out
  /// at the end. All results are in the reference camera's frame.
  const TrackResult& process(std::span<const Frame> views);

  /// Identity estimates so far, adopted ones included: the last TrackResult::subject. Same thread as process.
  std::uint32_t subjects() const;

  /// The person being tracked; nothing before the first identity estimate. Same thread as process.
  std::optional<Person> person() const;

  /// Estimates the person from the frames seen so far, however few: for a recording that is shorter than the
  /// acquisition. False where no face was seen well enough. Same thread as process.
  bool settle_subject();

  /// Takes over a subject estimated earlier, for frames of `width_px` x `height_px`: tracking starts with the
  /// first plausible face, without acquisition. A recording can so be tracked from its first frame on: once
  /// until person() is there, then again from the start with a tracker that adopted it. Throws Error(Usage)
  /// where the subject does not fit the model. Same thread as process.
  void adopt(const Person& person, int width_px, int height_px);

  /// Forgets identity and focal length; the next good frames estimate them anew. Same thread as process.
  void reset_identity();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::track
