#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "facet/messages.hpp"
#include "pipeline/frame_set_sink.hpp"
#include "pipeline/mesh_sink.hpp"
#include "pipeline/pipeline.hpp"
#include "service/config.hpp"

namespace facet::service {

/// Who may be given what a pipeline makes. They outlive it.
struct Sinks {
  pipeline::MeshSink& stream;
  pipeline::MeshSink& bridges;
  pipeline::MeshSink& take;
  pipeline::FrameSetSink& sets_shown;     ///< to the stream and the take
  pipeline::FrameSetSink& sets_recorded;  ///< to the take alone
};

/// What a pipeline of any mode is made of.
struct OpenedPipeline {
  std::string source_name;               ///< as takes tell it
  bool live = false;                     ///< the source goes on while nobody reads
  std::vector<Messages::Message> lines;  ///< what was opened, for the log
  /// Once; what was opened becomes the pipeline's.
  std::function<std::unique_ptr<pipeline::Pipeline>(const Sinks&)> make;
};

/// What runs in a mode; its name is kModes'.
struct ModeRow {
  /// Throws Error(Usage) where the configuration lacks what a daemon in this mode needs.
  void (*check)(const Config& config);
  /// Opens sources, models and devices. Seconds. Throws Error.
  OpenedPipeline (*open)(const Config& config);
};
const ModeRow& mode_row(Mode mode);

/// Throws Error(Usage) where the configuration lacks what a daemon needs: a source, or a rig that can be.
/// file: for the message.
void require_source(const Config& config, const std::filesystem::path& file);

}  // namespace facet::service
