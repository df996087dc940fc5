#pragma once

#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <variant>

#include "facet/error.hpp"
#include "pipeline/booth.hpp"
#include "pipeline/frames.hpp"
#include "pipeline/live_views.hpp"
#include "pipeline/stages.hpp"
#include "service/config.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {

/// What a pipeline of any mode is made of.
using Opened = std::variant<pipeline::Stages, pipeline::LiveViews, pipeline::Rig, pipeline::Booth>;

/// Opens the pipeline's stages or devices on the thread `facet-open`, which can't be broken off: models are
/// read, drivers loaded and kernels compiled meanwhile. The destructor waits for it. One thread uses this
/// object.
class StageOpener {
 public:
  /// Begins at once.
  explicit StageOpener(const Config& config);
  StageOpener(const StageOpener&) = delete;
  StageOpener& operator=(const StageOpener&) = delete;

  /// Readable once there is a result.
  int fd() const;
  bool done() const;

  /// Once. Throws what opening threw. Only when done().
  Opened take();

 private:
  struct Result;
  std::shared_ptr<Result> result_;
  std::jthread thread_;
};

}  // namespace facet::service
