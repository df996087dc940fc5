#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "pipeline/mesh_sink.hpp"
#include "pipeline/messages.hpp"
#include "pipeline/progress.hpp"
#include "pipeline/recovering_refiner.hpp"
#include "pipeline/stages.hpp"
#include "pipeline/status.hpp"

namespace facet::pipeline {

/// One colour camera in, refined meshes out: capture -> track (CPU) -> refine (GPU) -> sinks.
///
/// Threads, what each does and what it may block on:
/// * `facet-capture`: Camera::start, next, stop. The source; where it is recorded also room in a queue.
/// * `facet-track`: CoarseStage. An empty queue, and until refine takes a frame.
/// * `facet-refine`: the hierarchy of a new subject, RefineStage, MeshSink::deliver. An empty queue, the GPU,
///   a sink.
/// * `facet-regpu`: RecoveringRefiner, after a device loss. The driver.
///
/// start begins the first three, stop joins them. The tracker works on frame n + 1 while the GPU works on n.
/// Queues: captured frames, where a live source's newest frame replaces an older one (the drop is counted)
/// and a recorded source waits; one tracked frame. The hierarchy is built inline on `facet-refine` at the
/// first frame in state Tracking of a subject: a recorded source waits for it, of a live one some frames are
/// dropped.
///
/// Life: construct -> start -> (ends by itself, or request_stop) -> stop -> destroy. Sinks outlive the
/// pipeline and are called until stop returns.
class MonocularPipeline {
 public:
  struct Options {
    mesh::HierarchyOptions hierarchy;
    FrameRange frames;
    RecoveringRefiner::Pauses pauses;
  };

  MonocularPipeline(Stages stages, const Options& options, std::vector<MeshSink*> sinks);
  ~MonocularPipeline();
  MonocularPipeline(const MonocularPipeline&) = delete;
  MonocularPipeline& operator=(const MonocularPipeline&) = delete;

  void start();

  /// First phase of stopping: no thread begins another frame. Any thread, returns at once, idempotent.
  void request_stop();
  /// Second phase: waits for the frames in the stages. Idempotent; the destructor calls both.
  void stop();
  /// Whether every thread has done its last work, so that stop will not block. Any thread.
  bool finished() const;

  /// Any thread; takes a lock that is held for copying a few hundred bytes.
  PipelineStatus status() const;

  /// The thread that was silent for the longest time; none before start and once all have ended. Waits of one
  /// thread for another are not silence, the helper `facet-regpu` is not looked at. Any thread.
  std::optional<Progress::Silence> longest_silence() const;

  /// Identity and focal length are estimated anew from the next good frames. Any thread.
  void reset_identity();

  /// What happened since the last call, for the log. Any thread.
  std::vector<Messages::Message> take_messages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::pipeline
