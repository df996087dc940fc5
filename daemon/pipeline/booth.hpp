#pragma once

#include <memory>
#include <vector>

#include "pipeline/booth_meshes.hpp"
#include "pipeline/frames.hpp"
#include "pipeline/sets_pipeline.hpp"

namespace facet::pipeline {

/// The devices and stages of a live booth, opened.
struct Booth {
  Devices devices;
  BoothParts stages;
};

/// Throws Error(Usage) where the cameras and the trigger are none that a booth's meshes can be made of.
void check(const DevicesConfig& devices, const BoothConfig& booth);

/// Opens both; see open_devices and open_booth. Throws Error(Usage) where the rig file names a camera that is
/// not among the devices.
Booth open_booth(const DevicesConfig& devices, const BoothConfig& config);

/// A live booth: frame sets as FramesPipeline makes them, and meshes as BoothMeshes makes
/// them; their threads. Slots for which the stages are too slow have no mesh, and are counted as
/// dropped.
class BoothPipeline final : public SetsPipeline<BoothMeshes> {
 public:
  /// set_sinks: get every frame set; mesh_sinks: every slot that a mesh was asked of, later.
  BoothPipeline(Booth booth, std::vector<FrameSetSink*> set_sinks, std::vector<MeshSink*> mesh_sinks);

  PipelineStatus status() const override;
};

}  // namespace facet::pipeline
