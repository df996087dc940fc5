#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "facet/camera.hpp"
#include "facet/frame_set.hpp"
#include "pipeline/frame_range.hpp"

namespace facet::pipeline {

/// Where frame sets come from, one after the other. One thread.
class SetSource {
 public:
  SetSource() = default;
  SetSource(const SetSource&) = delete;
  SetSource& operator=(const SetSource&) = delete;
  virtual ~SetSource() = default;

  /// The next set, `timeout` at most. Never throws.
  virtual CaptureOutcome next(std::shared_ptr<const FrameSet>& out, std::chrono::milliseconds timeout) = 0;
  virtual std::string last_error() const = 0;  ///< as Camera::last_error
};

/// Cameras of frame sets, each by itself: the first one's `next` takes a set, the others' give their pictures
/// of that same set. A picture that is missing is an empty frame of the camera's size. Frames have the set's
/// slot as number, and its times. How the devices do is not theirs to know: their state is Idle.
/// cameras: one at least; the name is that in the sets. All are used by one thread.
std::vector<std::unique_ptr<Camera>> set_cameras(std::shared_ptr<SetSource> source,
                                                 const std::vector<CameraInfo>& cameras);

/// The same of a recorded take of frame sets: those of its cameras that are named, in that order, and the
/// slots of a range. frame_count is that of the sets. Throws Error: UnreadableInput where the take can't be
/// read or has no pictures there; Usage, naming those that there are, where it has no such camera.
std::vector<std::unique_ptr<Camera>> take_cameras(const std::filesystem::path& file,
                                                  const std::vector<std::string>& names,
                                                  const FrameRange& slots);

}  // namespace facet::pipeline
