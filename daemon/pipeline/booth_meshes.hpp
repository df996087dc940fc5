#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "booth/booth_depth.hpp"
#include "booth/performance_tracker.hpp"
#include "booth/rig_check.hpp"
#include "capture/slot_program.hpp"
#include "facet/messages.hpp"
#include "pipeline/booth_config.hpp"
#include "pipeline/frame_set_sink.hpp"
#include "pipeline/mesh_sink.hpp"
#include "pipeline/progress.hpp"
#include "pipeline/status.hpp"

namespace facet::pipeline {

/// What makes a booth's meshes.
struct BoothParts {
  std::shared_ptr<const capture::Rig> rig;
  capture::SlotProgram program;  ///< BoothConfig's, as the three below
  bool program_rules = false;
  bool lights = true;
  bool every_slot = false;
  std::unique_ptr<booth::DepthSource> depth;
  std::unique_ptr<booth::PerformanceTracker> tracker;  ///< null: depth alone, and nothing is handed out
  std::unique_ptr<booth::RigCheck> check;
  int blanks_per_run = 1;
};

/// Opens rig file, model, landmark nets and device. Seconds. blanks_per_run: blank slots whose depth is found
/// together; more are cheaper a slot (their windows share slots) and come later. One is for live use: start
/// values of the run before are kept, so that depths depend on the runs before (BoothDepth::Starts). Throws
/// Error: Usage for the rig and the configuration, UnreadableInput for files, NoDevice.
BoothParts open_booth(const BoothConfig& config, int blanks_per_run);

/// Frame sets in, one mesh for every blank slot, or for every slot, out, in their order. Threads, what each
/// does and what it may block on:
/// * whoever delivers: the order of slots, windows in time.
/// * `facet-depth`: BoothDepth. An empty queue, the GPU, room in a queue.
/// * `facet-perform`: PerformanceTracker, MeshSink::deliver. An empty queue, a sink.
class BoothMeshes final : public FrameSetSink {
 public:
  enum class WhenBusy {
    Drop,  ///< live: older slots that wait give way to newer ones, counted
    Wait,  ///< recorded: deliver waits
  };

  /// Told of the depth maps, [pairs], of every slot that gets a mesh, before that is made; on
  /// `facet-perform`.
  using DepthTaker = std::function<void(std::uint64_t slot, std::span<const capture::DepthMap> maps)>;

  BoothMeshes(BoothParts stages, WhenBusy when_busy, std::vector<MeshSink*> sinks,
              DepthTaker take_depth = {});
  ~BoothMeshes() override;

  void start();
  /// Slots ascending.
  void deliver(std::shared_ptr<const FrameSet> set) override;
  /// No more frames come: what waits is worked off.
  void finish();
  /// What waits is let go. Any thread, returns at once.
  void request_stop();
  void stop();
  bool finished() const;

  /// What it knows: device, meshes, tracking, times, queues, reasons. State Idle, or Failed where a thread
  /// failed. Any thread.
  PipelineStatus status() const;
  std::optional<Progress::Silence> longest_silence() const;
  /// The next slots are searched for a face. Any thread.
  void reset_identity();
  std::vector<Messages::Message> take_messages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::pipeline
