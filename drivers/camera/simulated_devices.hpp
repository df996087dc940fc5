#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/camera.hpp"
#include "facet/frame_set.hpp"
#include "facet/trigger.hpp"

namespace facet::simulated {

struct SimulatedCameraConfig {
  std::string name;
  int width_px = 640;   ///< at least 64
  int height_px = 480;  ///< at least 16
  double rate_hz = 30;  ///< of a camera that nobody triggers
};

/// What simulated cameras see in place of markers: a performance, slot by slot.
struct Footage {
  struct Picture {
    int width_px = 0;
    int height_px = 0;
    int channels = 3;                  ///< 3: sRGB; 1: grey
    std::vector<std::uint8_t> values;  ///< [height_px][width_px][channels]
  };
  std::vector<std::string> cameras;         ///< [camera_count]
  std::vector<std::vector<Picture>> slots;  ///< [slot_count][camera_count], whole periods
  std::vector<LineMask> patterns;           ///< projector lines in a period's slots, TriggerProgram::patterns
  double slots_per_second = 60;

  /// Adds a slot. Throws Error(UnreadableInput) where a camera has no picture in it.
  void add(const FrameSet& set);
};

/// What hangs on the wires of a virtual trigger: cameras that expose when all camera lines are active, in a
/// room lit by what the projector lines select. A picture shows, in two rows of black and white cells, which
/// projector lines were active and the camera's own count (read_marker), over a grey ramp that moves. So a
/// test can tell which slot a picture was taken in without believing any clock. Any thread.
///
/// With footage a picture is the camera's own of a period of it: of the slot in the period that the projector
/// lines select, black where none is like that. The performance begins once all cameras run, and goes on with
/// the clock whether they are fired or not; before and after it the first and the last period are seen.
class SimulatedDevices {
 public:
  /// The masks are those of the trigger's program.
  SimulatedDevices(LineMask camera_lines, LineMask projector_lines,
                   std::shared_ptr<const Footage> footage = nullptr);

  /// For VirtualTriggerOptions::on_change.
  void on_change(LineMask active, std::int64_t time_ns);

  /// A live camera; it may outlive the rig. Throws Error(Usage) where the footage lacks a camera of that
  /// name; with footage sizes are those of its pictures. `triggered`: exposes with the lines, else by itself.
  /// Its time stamps are those of the exposure, its pictures come 2 ms later.
  std::unique_ptr<Camera> camera(const SimulatedCameraConfig& config, bool triggered) const;

 private:
  struct Wires;
  std::shared_ptr<Wires> wires_;
};

/// The rows of cells, from the top.
enum class Marker { Lines, Count };

/// Reads a row of 64 cells, each 1/64 of the width and 1/16 of the height: bit i is cell i, white is 1.
/// Throws Error(UnreadableInput) where a cell is neither black nor white.
std::uint64_t read_marker(const Frame& frame, Marker marker);

}  // namespace facet::simulated

namespace facet::camera {

/// One that runs by itself and shows markers. FramesPipeline hangs its own on the trigger (SimulatedDevices).
extern const CameraKind kSimulatedCamera;

}  // namespace facet::camera
