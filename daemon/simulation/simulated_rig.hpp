#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "facet/camera.hpp"
#include "facet/trigger.hpp"

namespace facet::simulation {

struct RigCameraConfig {
  std::string name;
  int width_px = 640;   ///< at least 64
  int height_px = 480;  ///< at least 16
  double rate_hz = 30;  ///< of a camera that nobody triggers
};

/// What hangs on the wires of a virtual trigger: cameras that expose when all camera lines are active, in a
/// room lit by what the projector lines select. A picture shows, in two rows of black and white cells, which
/// projector lines were active and the camera's own count (read_marker), over a grey ramp that moves. So a
/// test can tell which slot a picture was taken in without believing any clock. Any thread.
class SimulatedRig {
 public:
  /// The masks are those of the trigger's program.
  SimulatedRig(LineMask camera_lines, LineMask projector_lines);

  /// For VirtualTriggerOptions::on_change.
  void on_change(LineMask active, std::int64_t time_ns);

  /// A live camera; it may outlive the rig. `triggered`: exposes with the lines, else by itself. Its time
  /// stamps are those of the exposure, its pictures come 2 ms later.
  std::unique_ptr<Camera> camera(const RigCameraConfig& config, bool triggered) const;

 private:
  struct Wires;
  std::shared_ptr<Wires> wires_;
};

/// The rows of cells, from the top.
enum class Marker { Lines, Count };

/// Reads a row of 64 cells, each 1/64 of the width and 1/16 of the height: bit i is cell i, white is 1.
/// Throws Error(UnreadableInput) where a cell is neither black nor white.
std::uint64_t read_marker(const Frame& frame, Marker marker);

}  // namespace facet::simulation
