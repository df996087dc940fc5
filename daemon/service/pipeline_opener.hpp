#pragma once

#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "service/modes.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {

/// Opens the pipeline's stages or devices on the thread `facet-open`, which can't be broken off: models are
/// read, drivers loaded and kernels compiled meanwhile. The destructor waits for it. One thread uses this
/// object.
class PipelineOpener {
 public:
  /// Begins at once.
  explicit PipelineOpener(const Config& config);
  PipelineOpener(const PipelineOpener&) = delete;
  PipelineOpener& operator=(const PipelineOpener&) = delete;

  /// Readable once there is a result.
  int fd() const;
  bool done() const;

  /// Once. Throws what opening threw. Only when done().
  OpenedPipeline take();

 private:
  struct Result;
  std::shared_ptr<Result> result_;
  std::jthread thread_;
};

}  // namespace facet::service
