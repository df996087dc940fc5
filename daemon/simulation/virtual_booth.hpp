#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "capture/patterns.hpp"
#include "capture/rig.hpp"
#include "capture/slot_program.hpp"
#include "face/face_model.hpp"
#include "facet/frame_set.hpp"
#include "simulation/actor.hpp"
#include "simulation/truth_mesh.hpp"

namespace facet::simulation {

enum class BoothScene : std::uint8_t {
  Actor,   ///< the virtual actor performs
  Plane,   ///< a matt plate of 240x240 mm, tilted by up to 12 degrees; still
  Sphere,  ///< a matt ball of 120 mm diameter; still
};

struct VirtualBoothConfig {
  std::uint64_t seed = 1;                   ///< of rig, actor, performance, targets, noise
  std::optional<std::uint64_t> actor_seed;  ///< of somebody else, and another performance, in the same booth
  /// The actor's; as in ActorTraits and PerformanceConfig.
  double outside_span_mm = ActorTraits{}.outside_span_mm;
  double start_s = 0;
  std::shared_ptr<const RecordedCurves> curves = nullptr;
  BoothScene scene = BoothScene::Actor;
  double resolution = 1;  ///< of the cameras, of 640x480 px; 0.25 to 4 (make_booth_rig)
  double slots_per_second = 60;
  /// From the trigger on; the actor moves meanwhile. 0: a moment.
  double exposure_ms = 5;
  /// Rays a pixel, each through another point of it and at another moment of the exposure. 1 to 64.
  int samples = 4;
  /// Share of the performance's head motion that the actor makes: who sits in a booth turns by 10 degrees at
  /// most. 0 to 1.
  double head_motion = 0.4;
  /// The actor holds the pose of this moment of the performance, s, as for a still scan; nothing: performs.
  std::optional<double> pose_s;
  /// A target stands this far from where the seed puts it, mm, rig frame. Up to 200.
  Eigen::Vector3d target_shift_mm{0, 0, 0};
  /// Room light at the face, of what both projectors give in white.
  double ambient = 0.05;
  double projector_blur_px = 0.6;  ///< sigma, projector's pixels; 0 to 3
  bool sensor_noise = true;
  /// Skin's mirrored light: reflectance at normal incidence (0.04 is dry skin's), 0: matt; its roughness.
  double gloss = 0;
  double gloss_roughness = 0.5;
  /// Lamps that slots may be lit by; they are in the rig as it is given out.
  std::vector<capture::RigLight> lights;
  capture::PatternConfig patterns;  ///< its size is taken from the projectors
};

/// What is true of one camera's picture at the middle of its exposure. All [height_px][width_px].
struct DepthTruth {
  int width_px = 0;
  int height_px = 0;
  std::vector<float> depth_mm;       ///< z in the camera frame at the pixel's centre; 0 where nothing is seen
  std::vector<std::uint8_t> skin;    ///< 1 on face skin, and on the targets
  std::vector<std::uint8_t> shared;  ///< 1 where the other camera of the pair sees the same point
};

/// A still target's form, rig frame.
struct BoothTarget {
  Eigen::Vector3d centre_mm{0, 0, 0};  ///< of the plate or ball
  Eigen::Vector3d normal{0, 0, 1};     ///< of the plate, unit, towards the cameras
  double radius_mm = 0;                ///< of the ball; 0: a plate
};

/// One slot in the virtual booth: what was in front of the cameras, under the light that was shown. Computed
/// as it is asked for. Keeps what it needs of its booth alive. One thread (it uses two inside).
class BoothSlot {
 public:
  ~BoothSlot();
  BoothSlot(BoothSlot&& other) noexcept;
  BoothSlot& operator=(BoothSlot&& other) noexcept;

  std::uint64_t number() const;
  const capture::Shown& shown() const;
  /// When the cameras were fired: number / slots_per_second.
  std::int64_t trigger_ns() const;

  /// The picture of a camera: pattern or blank light of both projectors with their shadows, room light,
  /// optics, exposure, noise. Monochrome: R = G = B. Throws Error(Usage) for a camera that is not there.
  Frame frame(std::size_t camera) const;
  /// All cameras' pictures.
  FrameSet frame_set() const;
  /// other: the camera that `shared` tells of; nothing: all 0. Throws Error(Usage) as above.
  DepthTruth depth(std::size_t camera, std::optional<std::size_t> other = std::nullopt) const;
  /// The surface at the middle of the exposure, rig frame: head without eyeballs and teeth, or target. The
  /// topology is the same in every slot and a vertex the same point of the skin, so that differences between
  /// slots are the scene flow.
  TruthMesh surface() const;

 private:
  friend class VirtualBooth;
  struct Impl;
  explicit BoothSlot(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// The virtual booth: six cameras and two projectors (make_booth_rig) around an actor or a target, rendered
/// by ray casting. Light goes one way: projector, lamp or room, skin (matt unless `gloss`), camera; nothing
/// is lit by skin. Slots may be asked for in any order and come out the same. Any thread once built.
class VirtualBooth {
 public:
  /// model: of the actor, not needed afterwards; null for targets. Throws Error(Usage) where the
  /// configuration is out of range or an actor has no model, Error(UnreadableInput) where the model has no
  /// landmark map.
  VirtualBooth(const face::FaceModel* model, const VirtualBoothConfig& config);

  const VirtualBoothConfig& config() const;
  const capture::Rig& rig() const;
  /// Of the surface: 1 on face skin, 0 elsewhere, soft between; [vertex_count].
  const Eigen::VectorXf& skin() const;
  /// Nothing for the actor.
  std::optional<BoothTarget> target() const;

  /// A slot of the standard program.
  BoothSlot slot(std::uint64_t number) const;
  /// A slot in which the projectors show something else.
  BoothSlot slot(std::uint64_t number, const capture::Shown& shown) const;
  /// A slot of another program: the stripes of its number, a blank one, or lit: projectors in white, lamps.
  /// Throws Error(Usage) for a light that the rig does not have.
  BoothSlot slot(std::uint64_t number, const capture::SlotProgram& program) const;
  /// A slot in which each projector shows a picture of its size, in the rig's order; an empty picture: it is
  /// dark. Throws Error(Usage) where number or sizes are others.
  BoothSlot slot(std::uint64_t number, std::vector<capture::GreyImage> pictures) const;

 private:
  friend class BoothSlot;
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace facet::simulation
