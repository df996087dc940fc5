#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "face/face_model.hpp"
#include "stereo/rectification.hpp"
#include "stereo/stereo_matcher.hpp"

namespace facet::bench {

/// What a pair saw and how deep the things were.
struct StereoFootage {
  std::string name;
  capture::Rig rig;
  capture::StereoPair pair;
  stereo::DepthRange depths;
  int width_px = 0;
  int height_px = 0;
  std::vector<stereo::StereoSlot> slots;
  std::vector<std::vector<float>> truth_mm;  ///< [slots][height][width] rectified left; 0 where nothing is
  std::vector<std::vector<bool>> seen;  ///< [slots][height][width] to judge: skin, or all of a target, that
                                        ///< both cameras see
  std::vector<std::vector<bool>>
      nothing;                   ///< [slots][height][width] where the left camera sees no thing at all
  std::size_t first_judged = 0;  ///< slots whose windows are whole: whole periods
  std::size_t past_judged = 0;

  stereo::Rectification rectification() const { return {rig, pair, depths, width_px, height_px}; }
};

/// A scene of tests/support/support/stereo_scene.hpp.
struct SceneOptions {
  int width_px = 640;
  int height_px = 480;
  int slots = 9;
  int first_slot = 60;  ///< in the booth: the performance's first second is rest
  std::uint32_t seed = 1;
  double speed_mm_per_slot = 1.5;
  double stripe_mm = 2;
  double noise = 0.008;  ///< of a linear grey value at full light
};

/// scene: "plane", "sphere", "wave" or "step". Throws Error(Usage) for another.
StereoFootage scene_footage(const std::string& scene, const SceneOptions& options);

/// The virtual booth, whose pictures are 640 x 480: scene "actor", "booth-plane" or "booth-sphere"; pair 0
/// or 1. model: of the actor. Throws Error(Usage) for another scene.
StereoFootage booth_footage(const face::FaceModel& model, const std::string& scene, std::size_t pair,
                            const SceneOptions& options);

}  // namespace facet::bench
