#include "refine/recovering_refiner.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <exception>
#include <new>
#include <system_error>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "gpu/context.hpp"

namespace facet::refine {
namespace {

constexpr const char* kRefinementOff = "refinement off";

}  // namespace

RecoveringRefiner::RecoveringRefiner(std::unique_ptr<RefineStage> first, OpenRefiner open, Messages& messages,
                                     Pauses pauses)
    : open_(std::move(open)),
      messages_(messages),
      pauses_(pauses),
      stage_(std::move(first)),
      device_(stage_ != nullptr ? stage_->device() : std::string()) {}

RecoveringRefiner::~RecoveringRefiner() {
  request_stop();
}

void RecoveringRefiner::request_stop() {
  const Lock lock(mutex_);
  stop_ = true;
  stop_changed_.notify_all();
}

void RecoveringRefiner::set_subject(const SubjectSetup& subject) {
  subject_ = subject;
  has_subject_ = true;
  subject_given_ = false;
  adopt_reopened();
  if (stage_ != nullptr && !subject_given_) {
    give_subject();
  }
}

void RecoveringRefiner::give_subject() {
  subject_given_ = false;
  try {
    stage_->set_subject(subject_);
    subject_given_ = true;
  } catch (const gpu::DeviceLostError& error) {
    lose(error.what());
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::NoDevice) {
      throw;
    }
    refuse("this face's vertices", error.what());
    next_subject_try_ = Clock::now() + pauses_.longest;
  }
}

void RecoveringRefiner::restart() {
  // A device that comes back later has no frame before.
  if (stage_ != nullptr) {
    stage_->restart();
  }
}

const std::string& RecoveringRefiner::refine(const RefineInput& input, RefineOutput& output) {
  adopt_reopened();
  if (open_ == nullptr) {
    reason_ = kRefinementOff;
    return reason_;
  }
  if (stage_ == nullptr) {
    return reason_;
  }
  if (has_subject_ && !subject_given_) {
    if (Clock::now() >= next_subject_try_) {
      give_subject();
    }
    if (!subject_given_) {
      return reason_;
    }
  }
  RefineOutcome outcome = RefineOutcome::DeviceLost;
  try {
    outcome = stage_->refine(input, output);
  } catch (const gpu::DeviceLostError& error) {
    output.failure = error.what();
  } catch (const Error& error) {
    // A first picture of its size finds no room on the device.
    refuse("pictures of this size", error.what());
    return reason_;
  }
  switch (outcome) {
    case RefineOutcome::Refined:
      reason_.clear();
      break;
    case RefineOutcome::NumericalFailure:
      reason_ = output.failure.empty() ? "the refinement failed numerically" : output.failure;
      break;
    case RefineOutcome::DeviceLost:
      lose(output.failure.empty() ? "device lost" : output.failure);
      break;
  }
  return reason_;
}

void RecoveringRefiner::refuse(const char* what, const std::string& reason) {
  const std::string said = fmt::format(
      "no room for {} on {} ({}): end what else uses it, use a smaller picture or another gpu.device", what,
      device_, reason);
  if (said != reason_) {
    messages_.warning(said);
    reason_ = said;
  }
}

void RecoveringRefiner::lose(const std::string& reason) {
  messages_.warning(fmt::format("GPU {} lost ({}): frames are coarse until it is back", device_, reason));
  reason_ = "GPU lost, being reopened: " + reason;
  device_.clear();
  stage_.reset();
  helped_ = false;
  begin_reopening();
}

/// Where no thread can be made, the next frame tries again.
void RecoveringRefiner::begin_reopening() {
  if (helper_.joinable()) {
    helper_.join();  // ended when it handed over the device that is lost now
  }
  try {
    // Lives until it has a device or request_stop; joined above or by the destructor.
    helper_ = std::jthread([this, subject = subject_] { reopen(subject); });
    helped_ = true;
  } catch (const std::system_error&) {
    // Frames stay coarse, and say so, until there is one.
  }
}

void RecoveringRefiner::adopt_reopened() {
  if (stage_ != nullptr || open_ == nullptr) {
    return;
  }
  if (!helped_) {
    begin_reopening();
  }
  const mesh::Hierarchy* reopened_for = nullptr;
  {
    const Lock lock(mutex_);
    stage_ = std::move(reopened_);
    reopened_for = reopened_for_;
  }
  if (stage_ == nullptr) {
    return;
  }
  device_ = stage_->device();
  messages_.info(fmt::format("GPU {} is back", device_));
  if (has_subject_ && reopened_for != subject_.hierarchy.get()) {
    // The subject changed while the helper was at work.
    give_subject();
  } else {
    subject_given_ = has_subject_;
  }
}

void RecoveringRefiner::reopen(const SubjectSetup& subject) {
  ::pthread_setname_np(::pthread_self(), "facet-regpu");
  std::chrono::milliseconds pause = pauses_.first;
  for (;;) {
    {
      const Lock lock(mutex_);
      if (stop_changed_.wait_for(mutex_, pause, [&]() FACET_REQUIRES(mutex_) { return stop_; })) {
        return;
      }
    }
    pause = std::min(2 * pause, pauses_.longest);
    std::unique_ptr<RefineStage> stage = try_open(subject);
    if (stage != nullptr) {
      const Lock lock(mutex_);
      reopened_ = std::move(stage);
      reopened_for_ = subject.hierarchy.get();
      return;
    }
  }
}

/// Null where it is not there yet, or memory for it.
std::unique_ptr<RefineStage> RecoveringRefiner::try_open(const SubjectSetup& subject) {
  try {
    std::unique_ptr<RefineStage> stage = open_();
    if (subject.hierarchy != nullptr) {
      stage->set_subject(subject);
    }
    return stage;
  } catch (const std::exception& error) {
    try {
      messages_.warning(fmt::format("cannot reopen the GPU: {}", error.what()));
    } catch (const std::bad_alloc&) {
      // Told by the next attempt.
    }
    return nullptr;
  }
}

}  // namespace facet::refine
