#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "booth/rig_check.hpp"
#include "capture/frame_set.hpp"
#include "facet/camera.hpp"
#include "facet/error.hpp"
#include "facet/trigger.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::person {
struct PersonFile;
}

namespace facet::pipeline {

enum class PipelineState {
  Idle,       ///< not started
  Preparing,  ///< a recording is looked at ahead, for the subject
  Running,
  Ended,    ///< the source is at its end and every frame was handed out
  Stopped,  ///< on request, before the end
  Failed,   ///< see PipelineStatus::reason
};
const char* to_string(PipelineState state);

/// Times of one stage over the last frames in which it ran (Window::kLength at most), ms.
struct StageFigures {
  float mean_ms = 0;
  float p95_ms = 0;
};

/// One stage of mesh::StageTimes and its name, for whoever lists them.
struct Stage {
  const char* name;
  float mesh::StageTimes::*time_ms;
};
inline constexpr std::array kStages = {
    Stage{"capture", &mesh::StageTimes::capture_ms},
    Stage{"detect", &mesh::StageTimes::detect_ms},
    Stage{"landmarks", &mesh::StageTimes::landmarks_ms},
    Stage{"fit", &mesh::StageTimes::fit_ms},
    Stage{"upload", &mesh::StageTimes::upload_ms},
    Stage{"lighting", &mesh::StageTimes::lighting_ms},
    Stage{"albedo", &mesh::StageTimes::albedo_ms},
    Stage{"displacement", &mesh::StageTimes::displacement_ms},
    Stage{"readback", &mesh::StageTimes::readback_ms},
    Stage{"depth", &mesh::StageTimes::depth_ms},
    Stage{"latency", &mesh::StageTimes::latency_ms},
};

/// How often a stage took how long since the start. Fixed memory.
struct Histogram {
  static constexpr std::array kBounds_ms = {1.0F,   2.0F,   5.0F,   10.0F,   20.0F,  50.0F,
                                            100.0F, 200.0F, 500.0F, 1000.0F, 2000.0F};
  std::array<std::uint64_t, kBounds_ms.size() + 1> counts{};  ///< [i]: up to kBounds_ms[i]; the last: beyond
  double sum_ms = 0;

  void add(float value_ms) {
    std::size_t i = 0;
    while (i < kBounds_ms.size() && !(value_ms <= kBounds_ms.at(i))) {
      ++i;
    }
    ++counts.at(i);
    sum_ms += static_cast<double>(value_ms);
  }
};

struct DeviceCameraStatus {
  std::string name;  ///< in the rig
  CameraInfo info;
  CameraStatus status;
};

/// Several cameras and what fires them.
struct DevicesStatus {
  std::vector<DeviceCameraStatus> cameras;
  std::optional<TriggerStatus> trigger;  ///< none where the cameras run freely
  std::uint64_t triggers_opened = 0;     ///< more than 1: lines were lost and taken again
  capture::CaptureStatistics sets;
};

/// What the head before a live camera has shown of its own shape. A snapshot.
struct LearningStatus {
  enum class State { Looking, Solving, Learned };

  State state = State::Looking;
  std::uint32_t subject = 0;  ///< whose it is: track::TrackResult::subject
  std::string
      note;  ///< for people: why nothing was learned, or what waits; empty where nothing is to be said
  std::vector<std::array<float, 2>> seen_deg;  ///< orientations with a picture: where the camera stands in
                                               ///< the head's axes, yaw (to its left positive) and pitch (up)
  float turned_left_deg = 0;                   ///< the head, so far
  float turned_right_deg = 0;
  float needed_deg = 0;                              ///< of each
  int lamps = 0;                                     ///< that can fire in turn; 0: there are none
  float burst_s = 0;                                 ///< how long they do
  int bursts = 0;                                    ///< that are over, of whoever it is
  int lights = 0;                                    ///< that the last one showed the face under
  std::shared_ptr<const person::PersonFile> person;  ///< Learned: the shape, without a name
};
const char* to_string(LearningStatus::State state);

/// What the pipeline has done and how it does now. A snapshot.
struct PipelineStatus {
  PipelineState state = PipelineState::Idle;
  std::string reason;  ///< for people: why it Failed, or what the source said when it Ended early
  ErrorKind failure_kind = ErrorKind::Internal;  ///< where Failed; UnreadableInput: it was the source
  CameraInfo source;
  CameraStatus camera;                      ///< how the source does now
  std::optional<DevicesStatus> rig;         ///< in place of source and camera where there are several
  std::vector<booth::RigPairStatus> pairs;  ///< of a booth: whether its cameras stand as they were calibrated
  std::string device;                       ///< of the refinement, for people; empty while there is none
  std::uint64_t captured = 0;               ///< frames that the source produced, within the range asked for
  /// Of these, frames that no stage saw: the stages are slower than a live source.
  std::uint64_t dropped = 0;
  std::uint64_t processed = 0;       ///< frames handed out
  std::uint64_t mesh_frames = 0;     ///< of these, in state Tracking
  std::uint64_t face_frames = 0;     ///< of these, with landmarks of a face
  std::uint64_t refined_frames = 0;  ///< of these, with displacements
  std::uint64_t degraded_frames = 0;
  std::string degraded_reason;  ///< of the last degraded frame
  std::string given_up;         ///< what refinement leaves out to hold the camera's rate; empty where nothing
  std::uint64_t subjects = 0;   ///< hierarchies built
  std::int32_t finest_vertices = 0;
  int levels = 0;
  mesh::TrackingState tracking = mesh::TrackingState::Searching;  ///< of the last frame
  double frames_per_second = 0;                                   ///< handed out, over the last frames
  std::array<StageFigures, kStages.size()> stages;                ///< order of kStages
  std::array<Histogram, kStages.size()> histograms;               ///< likewise, since the start
  std::size_t queued_captured = 0;                                ///< frames that wait for the tracker
  std::size_t queued_tracked = 0;                                 ///< and for the refinement
  float photometric_rms = 0;                                      ///< mean over the last refined frames
  std::shared_ptr<const LearningStatus> learning;                 ///< null where no shape is learned
};

}  // namespace facet::pipeline
