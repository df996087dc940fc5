#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "capture/rig.hpp"
#include "mesh/hierarchy.hpp"
#include "pipeline/frame_range.hpp"
#include "refine/refiner.hpp"
#include "track/tracker.hpp"
#include "trigger/gpio_trigger.hpp"

namespace facet::pipeline {

/// Value of ShadingConfig::gpu_device for "coarse meshes only".
inline constexpr const char* kNoDevice = "none";

/// A calibrated camera and where its pictures come from.
struct RecordedCamera {
  capture::RigCamera camera;
  std::filesystem::path rig_file;  ///< that it is from, for messages
  camera::CameraConfig source;
};

/// Lamps of a kiosk that are switched in turn while a person is enrolled.
struct LampsConfig {
  std::vector<trigger::GpioOutput> outputs;  ///< none: there are no lamps
  bool active_low = false;
  int each_ms = 400;  ///< that each is on

  /// Lamps that change faster than three times a second can harm people who are sensitive to flicker.
  static constexpr int kLeastCalm_ms = 334;
};

/// What the monocular pipeline is asked to do; ShadingPipeline is the running of it.
struct ShadingConfig {
  camera::CameraConfig source;
  /// Recorded calibrated cameras instead of `source`: frame n of each was exposed at the same moment. The
  /// first one is the reference camera, in whose frame the meshes are; one is enough.
  std::vector<RecordedCamera> views;
  FrameRange frames;  ///< of the source; others are read and thrown away
  std::filesystem::path model_file;
  /// Who stands before the camera, enrolled with that model: a name of persons_folder, or a file
  /// (person::is_person_path). Empty: nobody who is known.
  std::string person;
  std::filesystem::path persons_folder;  ///< where persons are kept; empty: nowhere
  /// Where a head turns far enough its own shape is learned and followed: of one live camera beside the
  /// frames, of one recorded camera before the first frame, which takes longer than the recording.
  bool learn_live = false;
  bool learn_ahead = false;
  LampsConfig lamps;  ///< of whoever is learned live
  track::TrackerConfig tracker;
  mesh::HierarchyOptions hierarchy;
  refine::RefinerConfig refiner;
  std::string gpu_device = "auto";  ///< "auto", part of a device's name, or "none": no refinement
};

}  // namespace facet::pipeline
