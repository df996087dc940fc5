#pragma once

#include <filesystem>
#include <string>

#include "capture/slot_program.hpp"
#include "fit/skin_tracker.hpp"
#include "stereo/rectification.hpp"

namespace facet::pipeline {

/// What is asked of the meshes of a booth.
struct BoothConfig {
  std::filesystem::path rig_file;
  /// Along the pairs' viewing directions. 0 to 0: around the point that the pairs look at (depth_range).
  stereo::DepthRange depths;
  /// What lights the trigger's slots, again and again, where a slot does not say it itself
  /// (FrameSet::light). A blank one gets a mesh by what its pictures show.
  capture::SlotProgram program = capture::standard_program();
  bool program_rules = false;  ///< even where a slot says otherwise of itself
  /// Photometric stereo where slots are lit by known lights (booth::PhotometricStereo).
  bool lights = true;
  /// A mesh for every slot, not for blank ones alone: slots with stripes get theirs once the blank slot after
  /// them has its own.
  bool every_slot = false;
  /// Shading of the colour pictures on top of the fine levels that depth gives.
  bool shading = false;
  std::filesystem::path model_file;
  std::filesystem::path landmark_nets;
  std::filesystem::path points_file;  ///< FacePoints to begin with; empty: the landmark net finds the face
  std::string gpu_device = "auto";
  fit::SkinTrackerOptions skin;
};

/// Throws Error(Usage) where the configuration makes no sense.
void check(const BoothConfig& config);

}  // namespace facet::pipeline
