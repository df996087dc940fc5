#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "facet/frame.hpp"

namespace facet {

inline constexpr std::size_t kMaxCameras = 64;

/// One frame of every camera for one trigger slot; the currency of everything that sees with several cameras.
struct FrameSet {
  std::uint64_t slot = 0;  ///< the trigger's number; free-running cameras: counted from 0
  /// CLOCK_MONOTONIC: when the cameras were fired; free-running: the frames' time.
  std::int64_t trigger_ns = 0;
  std::int64_t media_time_ns = 0;  ///< since the first set of the run or of the recording
  std::vector<Frame> frames;       ///< [camera_count], empty where a camera's frame is missing
  std::uint64_t missing = 0;       ///< one bit per camera
  std::int64_t skew_ns = 0;  ///< from the earliest to the latest time of the frames, each camera's own lag to
                             ///< the trigger taken away; 0 for fewer than two
  std::shared_ptr<const std::vector<std::string>> camera_names;  ///< [camera_count]
  /// What lit the face, as a word: "stripes", "fringes:1", "blank", "light:NAME+NAME" (capture::SlotLight);
  /// empty: not known.
  std::string light;

  bool complete() const { return missing == 0; }
};

}  // namespace facet
