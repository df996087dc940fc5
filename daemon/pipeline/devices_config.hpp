#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "capture/slot_program.hpp"
#include "facet/trigger.hpp"
#include "trigger/gpio_trigger.hpp"

namespace facet::pipeline {

struct DeviceCamera {
  std::string name;  ///< unique
  camera::CameraConfig source;
  std::int64_t latency_ns = 0;  ///< capture::CaptureCamera::latency_ns
};

enum class TriggerKind {
  None,     ///< the cameras run freely
  Virtual,  ///< lines without wires, for simulated cameras
  Gpio,
};

/// Several cameras, and what fires them.
struct DevicesConfig {
  std::vector<DeviceCamera> cameras;  ///< 1 to 64
  double rate_hz = 30;                ///< of cameras that run freely; all of them
  int deadline_ms = 0;                ///< for a set to become complete; 0: six periods, 100 ms at least
  TriggerKind trigger = TriggerKind::None;
  TriggerProgram program;
  /// What the program's slots light the face with, as long as `program.patterns`; empty: not said
  /// (lights_of).
  capture::SlotProgram lights;
  trigger::GpioTriggerConfig gpio;  ///< kind Gpio; its thread options count for Virtual too
  /// A take whose pictures the simulated cameras show; empty: markers.
  std::filesystem::path footage;
  std::filesystem::path edge_log;  ///< what the lines did is written there; empty: nowhere
};

/// What its slots light the face with: what is said of it, else stripes where a line shows a pattern and
/// blank where none does.
capture::SlotProgram lights_of(const DevicesConfig& config);

/// Throws Error(Usage) where no rig is like that.
void check(const DevicesConfig& config);

}  // namespace facet::pipeline
