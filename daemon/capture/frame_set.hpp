#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "facet/frame_set.hpp"

namespace facet::capture {

enum class Synchronisation {
  Triggered,    ///< every slot of the trigger fires all cameras
  FreeRunning,  ///< no trigger: frames are matched by their time, within half a frame period
};

struct CaptureCamera {
  std::string name;
  /// From the trigger's edge to the frame's time stamp, as the camera is known to behave. What is learned
  /// stays within a quarter of the period of it: nothing but this number tells one slot from the next.
  std::int64_t latency_ns = 0;
};

struct CaptureConfig {
  std::vector<CaptureCamera> cameras;  ///< 1 to 64
  Synchronisation synchronisation = Synchronisation::Triggered;
  std::int64_t period_ns = 16'666'667;     ///< from slot to slot, or of the cameras' frames
  std::int64_t deadline_ns = 100'000'000;  ///< after its firing a set is handed out with what is there
  std::size_t open_sets = 8;               ///< sets kept at once, those that wait for the consumer included
};

/// Why a frame came into no set.
enum class Refusal : std::uint8_t {
  NoSlot,             ///< its time is far from every slot: a stale frame, or nobody fired
  TimeDisagrees,      ///< near a slot, yet further from it than a quarter of the period
  SequenceDisagrees,  ///< its number fits another slot than its time does
  Duplicate,          ///< the slot has this camera's frame already, or the number came before
  TooLate,            ///< the set was handed out without it
  Corrupt,            ///< the driver says that its pixels are damaged
  Overrun,            ///< too many frames waited for their slot to be fired
};
inline constexpr std::array kRefusals = {
    "no_slot", "time_disagrees", "sequence_disagrees", "duplicate", "too_late", "corrupt", "overrun"};

/// How one camera keeps up with the trigger. Means are exponential over about 32 frames.
struct CameraMatch {
  std::string name;
  std::uint64_t in_sets = 0;                              ///< frames that were matched to a slot in time
  std::uint64_t missing = 0;                              ///< sets handed out without this camera
  std::uint64_t lost = 0;                                 ///< frames that the driver's numbers leave out
  std::array<std::uint64_t, kRefusals.size()> refused{};  ///< by Refusal
  bool in_step = false;     ///< sequence and time agree; while they don't, its frames are refused
  double offset_ns = 0;     ///< from the trigger's edge to the frame's time stamp, mean
  bool offset_odd = false;  ///< the offset left what CaptureCamera::latency_ns allows
  double jitter_ns = 0;     ///< standard deviation of the time stamp about it
  double worst_ns = 0;      ///< largest distance from the mean so far
  double skew_ns = 0;       ///< of the time stamp to the mean of its set, mean
  double transport_ns = 0;  ///< from the time stamp to the frame's arrival, mean
};

struct CaptureStatistics {
  std::uint64_t slots = 0;       ///< fired
  std::uint64_t complete = 0;    ///< sets handed out whole
  std::uint64_t incomplete = 0;  ///< sets handed out with frames missing
  std::uint64_t dropped = 0;     ///< sets that the consumer did not take in time
  std::uint64_t odd_slots = 0;   ///< firings whose number or time did not grow: ignored
  std::int64_t worst_skew_ns = 0;
  std::vector<CameraMatch> cameras;
};

/// "no picture of camera A B": those of a set that are missing, for people; empty where none is.
std::string missing_pictures(const FrameSet& set);

}  // namespace facet::capture
