#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "facet/frame.hpp"

namespace facet {

/// What Camera::next came back with.
enum class CaptureOutcome {
  Delivered,    ///< a frame is in `out`
  Timeout,      ///< nothing within the time given; call again
  EndOfStream,  ///< a recorded source is at its end; every later call says so too
  Failed,       ///< the source is broken; last_error() says how
};

/// How a source does.
enum class CameraState {
  Idle,       ///< not started, or stopped
  Absent,     ///< the device is not there; looked for until it is
  Opening,    ///< started, its first frame is awaited
  Streaming,  ///< frames come
  Waiting,    ///< open, and no frames are due: its trigger stands still (told by who knows the trigger)
  Stalled,    ///< open, but frames stay out; started anew until they come
  Failing,    ///< see CameraStatus::reason; opened anew until it works
  Ended,      ///< a recorded source is at its end
};

constexpr const char* to_string(CameraState state) {
  constexpr std::array kNames = {"idle",    "absent",  "opening", "streaming",
                                 "waiting", "stalled", "failing", "ended"};
  return kNames.at(static_cast<std::size_t>(state));
}

/// Frames since the source was opened, by what became of them.
struct CameraCounters {
  std::uint64_t delivered = 0;
  std::uint64_t skipped = 0;  ///< a newer one had come before it was asked for
  std::uint64_t lost = 0;     ///< the driver's sequence numbers leave them out
  std::uint64_t omitted = 0;  ///< the numbers go on, yet the times lag behind by a frame period or more: the
                              ///< device left them out or slowed down; counted with the frame after
  std::uint64_t damaged = 0;  ///< delivered as corrupt: the driver or the decoder says so
  std::uint64_t truncated = 0;    ///< fewer bytes than the picture has; not delivered
  std::uint64_t undecodable = 0;  ///< no picture of the size agreed on; not delivered
  std::uint64_t stale = 0;        ///< exposed before the stream was started; not delivered
  std::uint64_t undated = 0;      ///< delivered with the time of arrival: the driver's time makes no sense
  std::uint64_t reopened = 0;     ///< not frames: how often the device was lost and delivered again
};

/// One of CameraCounters and its name, for whoever lists them.
struct CameraCount {
  const char* name;
  std::uint64_t CameraCounters::*value;
};
inline constexpr std::array kCameraCounts = {
    CameraCount{"delivered", &CameraCounters::delivered},
    CameraCount{"skipped", &CameraCounters::skipped},
    CameraCount{"lost", &CameraCounters::lost},
    CameraCount{"omitted", &CameraCounters::omitted},
    CameraCount{"damaged", &CameraCounters::damaged},
    CameraCount{"truncated", &CameraCounters::truncated},
    CameraCount{"undecodable", &CameraCounters::undecodable},
    CameraCount{"stale", &CameraCounters::stale},
    CameraCount{"undated", &CameraCounters::undated},
    CameraCount{"reopened", &CameraCounters::reopened},
};

/// A snapshot.
struct CameraStatus {
  CameraState state = CameraState::Idle;
  std::string reason;  ///< for people: why it is absent, stalled or failing; else empty
  CameraCounters counters;
};

/// What a source says of itself once it is open.
struct CameraInfo {
  std::string name;  ///< device or file, for people
  int width_px = 0;  ///< of the delivered frames, after rotation metadata is applied
  int height_px = 0;
  double rate_hz = 0;                          ///< nominal; 0 where unknown
  bool live = false;                           ///< a live source goes on while nobody reads
  std::optional<std::uint64_t> frame_count;    ///< recorded sources, an estimate from the container
  std::optional<CameraIntrinsics> intrinsics;  ///< where the source knows them
};

/// A source of frames. Life: open (a factory in drivers/camera, may throw Error) -> start -> next ... -> stop
/// -> destroy. One thread calls start, next, restart,
/// expect_frames and stop; info, status and last_error may be called from
/// any thread once open.
///
/// A live device may be absent, vanish, stall and come back at any time: these are states (status), `next`
/// says Timeout meanwhile. Failed and EndOfStream are for sources that can't come back.
class Camera {
 public:
  Camera() = default;
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;
  virtual ~Camera() = default;

  virtual CameraInfo info() const = 0;

  virtual CameraStatus status() const = 0;

  /// Begins delivery. Throws Error(UnreadableInput) where the source can't be started.
  virtual void start() = 0;

  /// Waits for the next frame, `timeout` at most. Never throws. A live source hands out the newest frame and
  /// skips older ones (gaps show in Frame::sequence); a recorded one hands out every frame. May take longer
  /// than `timeout` where a driver takes long to open its device.
  virtual CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) = 0;

  /// A live device is closed and opened anew by the next `next`; others do nothing. `why` becomes its reason
  /// meanwhile.
  virtual void restart(const std::string& /*why*/) {}

  /// Whether frames are due; from the start they are. While they are not, as with a camera whose trigger
  /// stands still, silence is no stall.
  virtual void expect_frames(bool /*due*/) {}

  /// Ends delivery; a `next` after it says EndOfStream. Idempotent.
  virtual void stop() = 0;

  /// What went wrong last, naming the source; empty where nothing did.
  virtual std::string last_error() const = 0;
};

}  // namespace facet
