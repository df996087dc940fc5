#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "render/renderer.hpp"
#include "simulation/actor.hpp"
#include "simulation/light.hpp"
#include "simulation/look.hpp"
#include "simulation/truth_mesh.hpp"
#include "simulation/webcam.hpp"

namespace facet::simulation {

struct ActorSequenceConfig {
  std::uint64_t seed = 1;
  std::optional<std::uint64_t> person;  ///< who the actor is; nothing: the seed says
  int width_px = 1280;
  int height_px = 720;
  int frame_count = 100;
  int rate_hz = 30;
  LightKind light = LightKind::SphericalHarmonics;
  bool highlights = false;  ///< painted skin shines (GGX)
  Look look = {};           ///< of skin and hair
  bool glasses = false;
  double outside_span_mm = ActorTraits{}.outside_span_mm;
  /// What the actor does; as in PerformanceConfig.
  double start_s = 0;
  bool calm_turn = false;
  Burst burst = Burst::None;  ///< after a calm turn (burst_light)
  std::shared_ptr<const RecordedCurves> curves = nullptr;
  double turn_deg = 0;  ///< besides its own motion the head turns to the subject's left by so much and back
  /// More than one: further cameras stand to both sides of the first one, each with an exposure and a white
  /// balance of its own.
  int camera_count = 1;
  double spread_deg = 25;  ///< from one camera to the next, as the head sees it
  int rays_per_pixel = 4;
  bool sensor_noise = true;
  WebcamEffects webcam;  ///< of all cameras, each with constants of its own
};

/// One rendered frame and what is true of it at its time: the middle of the exposure of the picture's middle
/// row.
struct SyntheticFrame {
  render::Picture picture;
  std::vector<render::Picture> further_pictures;  ///< [camera_count - 1]
  Eigen::Isometry3f camera_from_head = Eigen::Isometry3f::Identity();
  std::vector<float> expression;  ///< [expression_count]
  int lamp = -1;                  ///< of a strobe: which of the area lights fired; of a burst: which lamp
  CameraSettings settings;        ///< the first camera's
};

/// A virtual sequence: one actor, a camera or several, a light and a performance, all from one seed. Frames
/// may be rendered in any order and come out the same. One thread (it uses two inside).
class ActorSequence {
 public:
  /// Throws Error(Usage) where the configuration makes no sense or recorded curves are too short for it,
  /// Error(UnreadableInput) where the model has no landmark map or lacks an expression that they move. The
  /// model is not needed afterwards.
  ActorSequence(const face::FaceModel& model, const ActorSequenceConfig& config);
  ~ActorSequence();

  const ActorSequenceConfig& config() const;
  const CameraIntrinsics& camera() const;
  /// All cameras as calibrated, in the first one's frame: "video", "view-2", "view-3", ...
  const capture::Rig& rig() const;
  /// The first camera's constants.
  const Webcam& webcam() const;
  const std::string& model_name() const;  ///< of the face model that the actor is made of
  const std::vector<std::string>& expression_names() const;
  const std::vector<float>& identity() const;  ///< the part inside the model's span
  float outside_span_rms_mm() const;
  /// The head at rest, without any expression, in its head frame; in the topology of every frame's truth.
  TruthMesh neutral() const;
  /// Exposed: coefficients that give the linear picture values. Other than SH: its ambient part and the
  /// lamps.
  const Lighting& lighting() const;

  /// Renders frame `index` (0 <= index < frame_count).
  /// truth      the head's surface in the camera frame, without eyeballs, teeth, neck and glasses; or null
  /// surfaces   all surfaces that can be seen, strands aside, in the camera frame; or null
  SyntheticFrame render(int index, TruthMesh* truth, TruthMesh* surfaces = nullptr) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::simulation
