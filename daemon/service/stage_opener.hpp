#pragma once

#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "pipeline/stages.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {

/// Opens the pipeline's stages on the thread `facet-open`, which can't be broken off: models are read,
/// drivers loaded and kernels compiled meanwhile. One thread uses this object.
class StageOpener {
 public:
  /// Begins at once.
  explicit StageOpener(const pipeline::MonocularConfig& config);
  /// Waits for the thread.
  ~StageOpener();
  StageOpener(const StageOpener&) = delete;
  StageOpener& operator=(const StageOpener&) = delete;

  /// Readable once there is a result.
  int fd() const;
  bool done() const;

  /// The stages, once. Throws what open_stages threw. Only when done().
  pipeline::Stages take();

 private:
  struct Result;
  std::shared_ptr<Result> result_;
  std::thread thread_;
};

}  // namespace facet::service
