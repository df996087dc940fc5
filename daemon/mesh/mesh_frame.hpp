#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "facet/frame_set.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::mesh {

/// Where the tracker stands. Names on the wire and in exports: "searching", "acquiring", "tracking", "lost".
enum class TrackingState : std::uint8_t {
  Searching,  ///< no face known
  Acquiring,  ///< a face is found; identity and focal length are being estimated; the mesh, if any, is
              ///< provisional
  Tracking,   ///< pose and expression are solved every frame; the mesh is valid
  Lost,       ///< the face was there a moment ago; the tracker looks for it
};

const char* to_string(TrackingState state);

/// Times of one frame's stages, ms; 0 where a stage did not run.
struct StageTimes {
  float capture_ms = 0;       ///< decode or dequeue
  float detect_ms = 0;        ///< face detector
  float landmarks_ms = 0;     ///< landmark net
  float fit_ms = 0;           ///< coarse fit
  float upload_ms = 0;        ///< image and coarse mesh to the GPU, mips
  float lighting_ms = 0;      ///< [MD19 eq. 3]
  float albedo_ms = 0;        ///< [MD19 eq. 4]
  float displacement_ms = 0;  ///< [MD19 eq. 6], all levels
  float readback_ms = 0;
  float latency_ms = 0;  ///< from the frame's delivery to the mesh's hand-out
  float depth_ms = 0;    ///< a booth's depth maps
};

/// What does not change from frame to frame of one subject.
struct Subject {
  std::uint64_t id = 0;  ///< changes with every new identity or hierarchy; never 0
  std::shared_ptr<const Hierarchy> hierarchy;
  std::vector<std::string> expression_names;  ///< [expression_count]
  std::vector<float> identity;                ///< [identity_count] coefficients in standard deviations
  /// [3][control vertex_count] the face at rest of a person whose shape was learned, mm, head frame:
  /// `identity` is then the model's face that the expressions are carried over from. Empty: the model's own
  /// face.
  Vertices neutral_mm;
  std::vector<std::uint8_t> regions;  ///< [control vertex_count] bits of face::Region
  std::string person;                 ///< whose enrolled shape was followed; empty: the shape was guessed
};

/// Subject::id of a hierarchy, an identity and a person. count: of the estimates of this person, which may
/// come out alike.
std::uint64_t subject_id(const Subject& subject, std::uint32_t count);

/// Albedo of the finest level; a new object only when it changed.
struct Albedo {
  std::uint64_t version = 0;      ///< counts up; 0: none yet
  std::vector<float> linear_rgb;  ///< [finest vertex_count][3]
};

/// What a frame shows.
enum class Origin : std::uint8_t {
  Live,  ///< what the cameras see
  Take,  ///< a recorded frame, shown again
  Pose,  ///< a face that somebody posed or animated
};

const char* to_string(Origin origin);

/// One frame of output: the currency that the pipeline hands to streams and takes. Plain data; shared
/// read-only between threads. Head frame: x to the subject's left, y up, z out of the face; camera frame: x
/// right, y down, z forward; both mm.
struct MeshFrame {
  std::uint64_t sequence = 0;      ///< Frame::sequence of the image
  std::int64_t timestamp_ns = 0;   ///< Frame::timestamp_ns (CLOCK_MONOTONIC)
  std::int64_t media_time_ns = 0;  ///< Frame::media_time_ns
  TrackingState state = TrackingState::Searching;
  bool degraded = false;  ///< something failed for this frame (GPU lost, corrupt image): see degraded_reason
  std::string degraded_reason;
  Origin origin = Origin::Live;
  CameraIntrinsics camera;
  /// What the cameras saw, for readers of the stream and of takes; null where pictures are not passed on.
  /// What makes meshes is given frame sets, not this.
  std::shared_ptr<const FrameSet> images;

  // The rest is empty unless state is Tracking. While Acquiring a live face may have a provisional mesh:
  // subject (M0 alone, identity all 0), pose, expression and control vertices, of a shape that is still being
  // estimated.
  std::shared_ptr<const Subject> subject;
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();
  std::vector<float> expression;  ///< [expression_count] 0 to 1, order of Subject::expression_names
  /// [expression_count] 0 to 1: how far `expression` can be believed (track::ExpressionReader). Empty: not
  /// known.
  std::vector<float> expression_confidence;
  /// [expression_count] 0 to 1: what moves an avatar: `expression` counted from the person's neutral pose and
  /// tuned by name (avatar::Bridge::complete), as bridges send it. Empty: it is `expression`.
  std::vector<float> avatar_values;
  /// [expression_count] weights of the face model's shapes that make the control vertices, where those are
  /// not `expression`, which was read off the landmarks (track::ExpressionReader). Empty: they are. See
  /// shape_weights().
  std::vector<float> model_weights;
  std::vector<Eigen::Vector2f>
      landmarks_px;              ///< [landmark_count] as measured in the image; may be there while Acquiring
  float reprojection_px = 0;     ///< median distance of the tracked model's landmarks to the measured
  Vertices control_vertices_mm;  ///< [3][control_vertex_count] head frame
  std::vector<float>
      displacements_mm;           ///< [finest vertex_count] along the coarse normals; empty where not refined
  std::vector<float> confidence;  ///< [finest vertex_count] 0 to 1; empty where not refined
  std::array<float, 9>
      lighting{};  ///< SH coefficients of [MD19 eq. 1], camera frame with y up and z towards the camera
  std::shared_ptr<const Albedo> albedo;  ///< null until learned
  float photometric_rms = 0;             ///< rms of I - R over the visible refined vertices, linear 0 to 1
  StageTimes stage_ms;
};

/// True where the frame has a mesh: a subject with levels, and a vertex for each of its control vertices.
bool has_mesh(const MeshFrame& frame);

/// What the face model makes the frame's control vertices of: MeshFrame::model_weights, or `expression`.
inline const std::vector<float>& shape_weights(const MeshFrame& frame) {
  return frame.model_weights.empty() ? frame.expression : frame.model_weights;
}

}  // namespace facet::mesh
