#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "fit/skin_tracker.hpp"
#include "stereo/rectification.hpp"

namespace facet::pipeline {

/// What is asked of the meshes of a booth.
struct BoothConfig {
  std::filesystem::path rig_file;
  /// Along the pairs' viewing directions. 0 to 0: around the point that the pairs look at (depth_range).
  stereo::DepthRange depths;
  /// Of the trigger's slots, again and again: 1 where the projectors show stripes, 0 in a blank one, which
  /// gets a mesh by what its pictures show. At least one of either.
  std::vector<std::uint8_t> stripes = {1, 1, 0};
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
