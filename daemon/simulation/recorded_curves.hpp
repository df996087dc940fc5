#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "mesh/arkit.hpp"
#include "simulation/performance.hpp"

namespace facet::simulation {

/// A performance that somebody's face gave: ARKit's 52 values and the head's turns over time, as Live Link
/// Face records them (CSV). Immutable once read; any thread.
class RecordedCurves {
 public:
  /// Reads a recording: the columns Timecode, BlendShapeCount, ARKit's 52 names in any order, and where they
  /// are there HeadYaw, HeadPitch, HeadRoll and the eyes' angles. Rows without values (the app saw no face)
  /// are bridged in straight lines. Throws Error(UnreadableInput) naming file, line and column.
  static RecordedCurves read(const std::filesystem::path& file);
  /// The same from memory; source names it in messages.
  static RecordedCurves parse(std::string_view text, const std::string& source);

  const std::string& source() const { return source_; }
  /// From the first row with values to the last.
  double duration_s() const { return rows_.back().time_s; }
  /// Between 0 and 1, between rows in straight lines; before the first row the first, after the last the
  /// last.
  mesh::ArkitValues values(double time_s) const;
  /// Whether the recording turns the head: apps write zeros where they do not track it.
  bool turns_head() const { return turns_head_; }
  /// Turns alone: recordings have no place.
  HeadMotion head(double time_s) const;
  /// The most that each of ARKit's values reaches.
  const mesh::ArkitValues& largest() const { return largest_; }

  /// Sets a value to 0 throughout: "tongueOut". Throws Error(Usage) where it is none of ARKit's names.
  void leave_out(std::string_view name);

 private:
  struct Row {
    double time_s = 0;
    mesh::ArkitValues values{};
    std::array<float, 3> head_rad{};  ///< yaw, pitch, roll as recorded (mesh::live_link_angles)
  };
  struct Place {
    std::size_t row = 0;  ///< and the next one
    float part = 0;       ///< of the way to it
  };
  Place place(double time_s) const;

  std::string source_;
  std::vector<Row> rows_;  ///< at least two, times ascending from 0
  bool turns_head_ = false;
  mesh::ArkitValues largest_{};
};

}  // namespace facet::simulation
