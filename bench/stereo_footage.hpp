#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "capture/code_sequence.hpp"
#include "capture/rig.hpp"
#include "capture/slot_program.hpp"
#include "face/face_model.hpp"
#include "scan/phase_decoder.hpp"
#include "simulation/virtual_booth.hpp"
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
  capture::Lens lens;  ///< of the depth maps: the rectified left one
  std::vector<stereo::StereoSlot> slots;
  std::vector<std::vector<float>> truth_mm;  ///< [slots][height][width] of lens; 0 where nothing is
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
  double noise = 0.008;                                        ///< of a linear grey value at full light
  capture::SlotProgram program = capture::standard_program();  ///< of the booth's slots
  capture::CodeSequence sequence;                              ///< of structured light
  /// Of structured light: the actor moves while the phases are shown, of which so many orders of binomial
  /// self-compensation are made one set; below 0: the actor holds the pose.
  int compensation = -1;
};

/// scene: "plane", "sphere", "wave" or "step". Throws Error(Usage) for another.
StereoFootage scene_footage(const std::string& scene, const SceneOptions& options);

/// The virtual booth, whose pictures are 640 x 480: scene "actor", "still" (the actor holds the pose of the
/// first slot), "booth-plane" or "booth-sphere". model: of the actor. Throws Error(Usage) for another scene.
simulation::VirtualBoothConfig booth_config(const std::string& scene, const SceneOptions& options);

/// What a pair of the booth sees, slot by slot.
StereoFootage booth_footage(const simulation::VirtualBooth& booth, const std::string& scene, std::size_t pair,
                            const SceneOptions& options);

/// A still scene in structured light from one projector, as a pair's cameras see it.
struct CodedFootage {
  scan::DecodedView left, right;
  /// One slot, with the same truth as the pair's slots: what both cameras see of the skin or target.
  StereoFootage pair;
  /// The same of the left camera's lens without distortion: what it sees and the projector lights.
  StereoFootage projector;
  std::size_t left_camera = 0;
  std::size_t projector_index = 0;
};
CodedFootage coded_footage(const simulation::VirtualBooth& booth, const std::string& scene, std::size_t pair,
                           const SceneOptions& options, const scan::DecodeOptions& decode);

}  // namespace facet::bench
