#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "pipeline/frame_set_sink.hpp"
#include "pipeline/mesh_sink.hpp"
#include "pipeline/shading_parts.hpp"

namespace facet::test {

/// Something that a stage waits at until a test lets it pass.
class Gate {
 public:
  explicit Gate(bool open = true) : open_(open) {}
  void set(bool open);
  /// Waits until open.
  void pass();
  /// Waits until somebody waits in pass.
  void wait_for_visitor();

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool open_;
  int visitors_ = 0;
};

/// What the scripted stages do and what they saw. Outlives the pipeline.
struct Script {
  Script();

  // The camera.
  bool live = false;
  std::uint64_t frame_count = 10;
  std::uint64_t first_sequence = 0;
  std::uint64_t sequence_step = 1;   ///< more than 1: a live driver that skipped frames
  std::uint64_t fails_at = ~0ULL;    ///< sequence at which the camera is broken
  std::string end_note;              ///< what the camera says was wrong when it is at its end
  std::uint64_t corrupt_at = ~0ULL;  ///< sequence of a damaged image
  bool throws_at_start = false;
  bool silent = false;                                   ///< nothing ever comes
  std::map<std::uint64_t, CameraStatus> camera_changes;  ///< before the frame of that sequence
  std::mutex camera_status_mutex;
  CameraStatus camera_status;  ///< guarded by camera_status_mutex
  Gate camera_gate;            ///< before every frame
  std::atomic<bool> camera_stopped{false};

  // The tracker.
  std::function<mesh::TrackingState(std::uint64_t sequence)> state_of;
  bool mesh_while_acquiring = false;
  std::function<std::uint32_t(std::uint64_t sequence)> subject_of;
  std::uint64_t tracker_throws_at = ~0ULL;
  bool prepare_waits_for_stop = false;
  std::vector<float> read_confidence;  ///< track::TrackResult::value_confidence
  std::vector<float> read_values;      ///< track::TrackResult::values; empty: as a tracker that reads nothing
  pipeline::LearnedPerson learned;     ///< by prepare; the tracker may change it at its gate
  std::atomic<bool> keeps_model{false};  ///< as the pipeline last told the tracker
  Gate tracker_gate;                     ///< before every frame
  std::atomic<bool> preparing{false};
  std::atomic<int> identity_resets{0};
  std::atomic<bool> tracker_stopped{false};

  // The refiner.
  bool has_refiner = true;
  std::function<refine::RefineOutcome(std::uint64_t sequence)> outcome_of;
  std::uint64_t no_room_from = ~0ULL;  ///< sequence from which on the device has no room for the picture
  Gate refiner_gate;                   ///< before every frame
  std::atomic<int> failing_opens{0};   ///< so many attempts to open fail
  std::atomic<int> opens{0};
  std::atomic<int> subjects_set{0};
  std::vector<bool> known_shapes;  ///< refine::SubjectSetup::known_shape of each; on the refiner's thread
  std::vector<bool> known_skins;   ///< whether each came with the skin's albedo; on the refiner's thread
  std::vector<std::uint64_t> restarted_before;  ///< sequences of the frames refined first after a restart
  std::atomic<int> refiners_alive{0};
  std::atomic<float> time_limit_ms{-1};  ///< of the last frame
  std::atomic<bool> hurried{false};      ///< the refiner says that it gave something up

  std::shared_ptr<const face::FaceModel> model;

  pipeline::ShadingParts stages();
};

/// What arrived, in order. Keeps the frames unless told not to.
class CollectingSink final : public pipeline::MeshSink {
 public:
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override;

  std::vector<std::shared_ptr<const mesh::MeshFrame>> frames() const;
  /// Waits until a delivered frame passes.
  void wait_for(const std::function<bool(const mesh::MeshFrame&)>& passes);

  bool keep = true;
  std::vector<const mesh::MeshFrame*> addresses;  ///< of all frames; to be read when the pipeline has stopped

 private:
  mutable std::mutex mutex_;
  std::condition_variable arrived_;
  std::vector<std::shared_ptr<const mesh::MeshFrame>> frames_;
  std::function<bool(const mesh::MeshFrame&)> passes_;
  bool passed_ = false;
};

/// The same of frame sets.
class CollectingSets final : public pipeline::FrameSetSink {
 public:
  void deliver(std::shared_ptr<const FrameSet> set) override;
  std::vector<std::shared_ptr<const FrameSet>> sets() const;

 private:
  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<const FrameSet>> sets_;
};

}  // namespace facet::test
