#pragma once

#include <Eigen/Geometry>
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "facet/camera.hpp"
#include "facet/frame_set.hpp"
#include "pipeline/frame_range.hpp"

namespace facet::pipeline {

/// A camera whose pictures a source hands out.
struct PictureCamera {
  CameraInfo info;
  /// Where the source is calibrated; info.intrinsics is known then. The identity for the reference camera.
  std::optional<Eigen::Isometry3d> camera_from_reference;
};

/// Pictures of one moment after the other, of one camera or of several, live or recorded. One camera is a set
/// of one. Life as Camera's; one thread calls start, next, stop and last_error, any thread cameras and
/// status.
class PictureSource {
 public:
  PictureSource() = default;
  PictureSource(const PictureSource&) = delete;
  PictureSource& operator=(const PictureSource&) = delete;
  virtual ~PictureSource() = default;

  /// One at least; the first is the reference camera.
  virtual std::vector<PictureCamera> cameras() const = 0;
  /// How the reference camera does; Idle where that is another's to know.
  virtual CameraStatus status() const = 0;
  /// Throws as Camera::start.
  virtual void start() = 0;
  /// The pictures of the next moment, [camera_count] in the order of `cameras`; `out` changes only where they
  /// are Delivered. A picture that is missing is an empty frame. FrameSet::slot is the reference camera's
  /// Frame::sequence, or the slot. Else as Camera::next.
  virtual CaptureOutcome next(FrameSet& out, std::chrono::milliseconds timeout) = 0;
  virtual void stop() = 0;
  /// As Camera::last_error.
  virtual std::string last_error() const = 0;
};

/// Opens a source. A recorded one is opened twice: once to look ahead.
using OpenPictures = std::function<std::unique_ptr<PictureSource>()>;

/// One camera's pictures.
std::unique_ptr<PictureSource> one_camera(std::unique_ptr<Camera> camera);

/// Several cameras whose frames of one number are of one moment, such as videos that were cut to the frames
/// they share; at least one. Where one has no frame of a number that the first one has, the source is broken.
std::unique_ptr<PictureSource> cameras_in_step(std::vector<std::unique_ptr<Camera>> cameras);

/// The pictures of a recorded take of frame sets: those of its cameras that are named, in that order, and the
/// slots of a range. CameraInfo::frame_count is that of the sets. Throws Error: UnreadableInput where the
/// take can't be read or has no pictures there; Usage, naming those that there are, where it has no such
/// camera.
std::unique_ptr<PictureSource> take_sets(const std::filesystem::path& file,
                                         const std::vector<std::string>& names, const FrameRange& slots);

/// Another source's pictures without the lenses' distortion; intrinsics and places of its cameras are known.
/// known: [camera_count], from the rig file that is named for messages. Throws Error(Usage) where sizes are
/// not those calibrated at, or recorded cameras have different numbers of frames. Allocates a picture for
/// every frame of a lens that has distortion.
std::unique_ptr<PictureSource> calibrated(std::unique_ptr<PictureSource> pictures,
                                          const std::vector<capture::RigCamera>& known,
                                          const std::filesystem::path& rig_file);

/// Where a camera's picture is among a set's; nothing where it has no such camera.
std::optional<std::size_t> place_in(const FrameSet& set, const std::string& camera);

/// A set's pictures of these cameras, found by their names, as PictureSource::next hands them out: what is
/// missing has the camera's size, and every frame the set's slot as number, and its times.
FrameSet pictures_of(const FrameSet& set, const std::vector<PictureCamera>& cameras);

}  // namespace facet::pipeline
