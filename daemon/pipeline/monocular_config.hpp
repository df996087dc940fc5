#pragma once

#include <filesystem>
#include <string>

#include "camera/factory.hpp"
#include "mesh/hierarchy.hpp"
#include "pipeline/frame_range.hpp"
#include "refine/refiner.hpp"
#include "track/tracker.hpp"

namespace facet::pipeline {

/// Value of MonocularConfig::gpu_device for "coarse meshes only".
inline constexpr const char* kNoDevice = "none";

/// What the monocular pipeline is asked to do; MonocularPipeline is the running of it.
struct MonocularConfig {
  camera::CameraConfig source;
  FrameRange frames;  ///< of the source; others are read and thrown away
  std::filesystem::path model_file;
  track::TrackerConfig tracker;
  mesh::HierarchyOptions hierarchy;
  refine::RefinerConfig refiner;
  std::string gpu_device = "auto";  ///< "auto", part of a device's name, or "none": no refinement
};

}  // namespace facet::pipeline
