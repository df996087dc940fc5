#pragma once

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
/// -> destroy. One thread calls start, next and stop; last_error and info may be called from any thread once
/// open.
class Camera {
 public:
  Camera() = default;
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;
  virtual ~Camera() = default;

  virtual CameraInfo info() const = 0;

  /// Begins delivery. Throws Error(UnreadableInput) where the source can't be started.
  virtual void start() = 0;

  /// Waits for the next frame, `timeout` at most. Never throws. A live source hands out the newest frame and
  /// skips older ones (gaps show in Frame::sequence); a recorded one hands out every frame.
  virtual CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) = 0;

  /// Ends delivery; a `next` after it says EndOfStream. Idempotent.
  virtual void stop() = 0;

  /// What went wrong last, naming the source; empty where nothing did.
  virtual std::string last_error() const = 0;
};

}  // namespace facet
