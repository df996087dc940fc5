#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <thread>

#include "facet/clock.hpp"
#include "facet/messages.hpp"
#include "facet/mutex.hpp"
#include "refine/refine_stage.hpp"

namespace facet::refine {

/// A refine stage that survives the loss of its device (gpu::DeviceLostError or such an outcome, nothing
/// else): the lost one is thrown away and the helper thread `facet-regpu` opens another and gives it the
/// subject, again and again with pauses, while refine() says that there is none. Belongs to the thread that
/// calls refine; stop may be called from any thread.
class RecoveringRefiner {
 public:
  /// How long the helper waits after a failed attempt; doubled each time up to the longest.
  struct Pauses {
    std::chrono::milliseconds first{500};
    std::chrono::milliseconds longest{30'000};
  };

  /// open empty: refinement is off. `messages` outlives this object.
  RecoveringRefiner(std::unique_ptr<RefineStage> first, OpenRefiner open, Messages& messages, Pauses pauses);
  ~RecoveringRefiner();
  RecoveringRefiner(const RecoveringRefiner&) = delete;
  RecoveringRefiner& operator=(const RecoveringRefiner&) = delete;

  /// Sets the subject now and on every device that comes after a loss. Blocks for the upload. A device that
  /// is lost or has no room for it is what refine() says; where there was no room it is tried again after the
  /// longest pause. Throws what else Refiner::set_subject throws: Error(Usage).
  void set_subject(const SubjectSetup& subject);

  /// The next frame does not follow the one before: a face came back.
  void restart();

  /// Refines one frame. Returns an empty text where output holds a result, else why there is none, for
  /// MeshFrame::degraded_reason (valid until the next call). Throws as set_subject where a subject could not
  /// be set before.
  const std::string& refine(const RefineInput& input, RefineOutput& output);

  /// For people; empty while there is no device.
  const std::string& device() const { return device_; }

  /// The helper makes no further attempt; one that is under way can't be broken off.
  void request_stop();

 private:
  void give_subject();
  void refuse(const char* what, const std::string& reason);
  void lose(const std::string& reason);
  void begin_reopening();
  void adopt_reopened();
  void reopen(const SubjectSetup& subject);
  std::unique_ptr<RefineStage> try_open(const SubjectSetup& subject);

  OpenRefiner open_;
  Messages& messages_;
  Pauses pauses_;
  std::unique_ptr<RefineStage> stage_;
  std::string device_;
  std::string reason_;
  SubjectSetup subject_;
  bool has_subject_ = false;
  bool subject_given_ = false;            ///< to stage_
  Clock::time_point next_subject_try_{};  ///< where there was no room for it
  bool helped_ = true;                    ///< the helper of the last loss was made

  Mutex mutex_;
  Condition stop_changed_;
  bool stop_ FACET_GUARDED_BY(mutex_) = false;
  std::unique_ptr<RefineStage> reopened_ FACET_GUARDED_BY(mutex_);
  const mesh::Hierarchy* reopened_for_ FACET_GUARDED_BY(mutex_) = nullptr;  ///< whose subject reopened_ has
  std::jthread helper_;
};

}  // namespace facet::refine
