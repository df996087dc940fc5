#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "pipeline/mesh_sink.hpp"
#include "pipeline/pipeline.hpp"
#include "pipeline/shading_parts.hpp"
#include "refine/recovering_refiner.hpp"

namespace facet::pipeline {

/// One colour camera in, or several in step, refined meshes out: capture -> track (CPU) ->
/// refine (GPU) -> sinks.
///
/// Threads, what each does and what it may block on:
/// * `facet-capture`: PictureSource::start, next, stop. The source; where it is recorded also room in a
/// queue.
/// * `facet-track`: CoarseStage. An empty queue, and until refine takes a frame.
/// * `facet-refine`: the hierarchy of a new subject, refine::RefineStage, MeshSink::deliver. An empty queue,
/// the GPU,
///   a sink.
/// * `facet-detect`, one for each camera: the tracker's checks of a followed face, begun and ended by it; of
/// low
///   priority. Its work. longest_silence does not look at it, for no frame of a live source waits for it.
/// * `facet-skin`, where the skin of somebody live is followed: the looks at it, begun and ended by the
/// tracker's thread; of
///   low priority. Its work. longest_silence does not look at it: no frame waits for it, but for the change
///   to another person's model, which lets a look end.
/// * `facet-lamps`, while lamps fire: LampBurst. Its time; no frame waits for it.
/// * `facet-regpu`: RecoveringRefiner, after a device loss. The driver. longest_silence does not look at it.
///
/// start begins the first three, stop joins them. The tracker works on frame n + 1 while the GPU works on n.
/// Queues: captured frames, where a live source's newest frame replaces an older one (the drop is counted)
/// and a recorded source waits; one tracked frame. The hierarchy is built inline on `facet-refine` at the
/// first frame in state Tracking of a subject: a recorded source waits for it, of a live one some frames are
/// dropped.
class ShadingPipeline final : public Pipeline {
 public:
  struct Options {
    mesh::HierarchyOptions hierarchy;
    FrameRange frames;
    refine::RecoveringRefiner::Pauses pauses;
    /// One camera's pictures go with the frames (MeshFrame::images), for whoever reads or records them.
    bool hand_on_pictures = false;
  };

  ShadingPipeline(ShadingParts stages, const Options& options, std::vector<MeshSink*> sinks);
  ~ShadingPipeline() override;

  void start() override;
  void request_stop() override;
  void stop() override;
  bool finished() const override;
  PipelineStatus status() const override;
  std::optional<Progress::Silence> longest_silence() const override;
  void reset_identity() override;
  void burst() override;
  std::vector<Messages::Message> take_messages() override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::pipeline
