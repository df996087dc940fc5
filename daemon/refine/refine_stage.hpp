#pragma once

#include <functional>
#include <memory>
#include <string>

#include "refine/refiner.hpp"

namespace facet::refine {

/// The GPU refinement as the pipeline uses it: a context and a refiner on it; tests script one. One thread at
/// a time.
class RefineStage {
 public:
  RefineStage() = default;
  RefineStage(const RefineStage&) = delete;
  RefineStage& operator=(const RefineStage&) = delete;
  virtual ~RefineStage() = default;

  virtual std::string device() const = 0;  ///< for people
  /// What is wrong with the kernels kept from the start before (gpu::KernelCacheState::ignored); else empty.
  virtual std::string kernels_ignored() const { return {}; }
  /// As Refiner::set_subject. May throw gpu::DeviceLostError.
  virtual void set_subject(const SubjectSetup& subject) = 0;
  /// As Refiner::restart.
  virtual void restart() = 0;
  /// Submits a frame and waits for it.
  virtual RefineOutcome refine(const RefineInput& input, RefineOutput& output) = 0;
};

/// Opens the device and compiles the kernels. Throws Error(NoDevice).
using OpenRefiner = std::function<std::unique_ptr<RefineStage>()>;

/// Opens a context on the device and a refiner on it, each time anew.
OpenRefiner refiner_opener(const gpu::ContextOptions& options, const RefinerConfig& config);

}  // namespace facet::refine
