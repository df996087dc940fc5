#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "face/face_model.hpp"
#include "facet/mutex.hpp"
#include "person/enrolment.hpp"
#include "person/keyframes.hpp"
#include "pipeline/lamp_burst.hpp"
#include "pipeline/refined_relief.hpp"
#include "pipeline/shading_parts.hpp"
#include "track/tracker.hpp"

namespace facet::pipeline {

/// How a head is learned.
struct LearnOptions {
  person::EnrolmentOptions enrolment;
  track::TrackerConfig tracker;  ///< of the pictures' camera
  ReliefRefinement relief;
};

/// A head's own shape as a face model, and its camera.
struct LearnedFace {
  std::shared_ptr<const face::FaceModel> model;  ///< null: nothing was learned
  CameraIntrinsics camera;                       ///< with the focal length that was found
  person::LearnedShape shape;
  std::string note;  ///< for the log: what was learned, or why nothing
};

/// Solves for the shape of a head that turned, judges it and makes a face model of it (docs/person.md).
///
/// from    what it was learned from, for people: "this session"
/// go_on   asked several times a second, while the relief is refined every second or so; false breaks off
/// Ten seconds and more of one processor, and of the device a second. Any thread; throws nothing.
LearnedFace learn_face(const face::FaceModel& model, const person::Observed& observed,
                       const LearnOptions& options, const std::string& from,
                       const std::function<bool()>& go_on);

/// The tracker of one live camera, which learns the shape of the head before it beside the frames, on a
/// thread that gives way to them. Once the head turned far enough to both sides, and its shape was solved for
/// and judged, that is followed under the next subject number, without another acquisition; somebody else is
/// followed by the generic model again. One shape is learned of each person. As CoarseStage: one thread.
class LearningTracker final : public CoarseStage {
 public:
  /// Throws as track::Tracker. relief: on a device of its own. lamps: null: there are none
  LearningTracker(std::shared_ptr<const face::FaceModel> model, const track::TrackerConfig& config,
                  ReliefRefinement relief = {}, std::unique_ptr<LampBurst> lamps = nullptr);
  ~LearningTracker() override;

  void prepare(const std::function<bool()>& /*go_on*/) override {}
  /// The model is null while the generic one is followed.
  const LearnedPerson& learned() const override { return learned_; }
  void keep_model(bool keep) override { keep_model_ = keep; }
  const track::TrackResult& process(std::span<const Frame> views) override;
  void reset_identity() override;
  void burst() override;
  void request_stop() override { stopping_ = true; }

 private:
  /// What a solve ended with.
  struct Solved {
    LearnedFace face;
    std::unique_ptr<track::Tracker> tracker;           ///< follows that face; null: nothing was learned
    std::shared_ptr<const person::PersonFile> person;  ///< for whoever wants to keep it
  };

  void follow(track::Tracker& tracker, std::span<const Frame> views);
  void look(const Frame& picture);
  void look_at_lit(const Frame& picture);
  void begin_when_enough(std::int64_t media_time_ns);
  void solve(const std::function<bool()>& go_on, const person::Observed& observed);
  std::unique_ptr<track::Tracker> follower_of(const LearnedFace& face, const person::Observed& observed,
                                              const std::function<bool()>& go_on) const;
  void take_solved();
  void leave_person();
  void forget();
  void show(LearningStatus::State state);

  std::shared_ptr<const face::FaceModel> generic_model_;
  track::TrackerConfig config_;
  ReliefRefinement relief_;
  track::Tracker generic_;
  LearnedPerson learned_;
  std::unique_ptr<track::Tracker> own_;  ///< follows learned_.model; null: the generic one follows
  track::TrackResult result_;
  std::uint32_t subjects_before_ = 0;  ///< of the trackers before the one that follows now
  bool keep_model_ = false;

  person::KeyframeCollector keyframes_;  ///< of who is followed by the generic model
  std::size_t keyframes_seen_ = 0;
  std::unique_ptr<LampBurst> lamps_;
  bool burst_wanted_ = false;
  bool bursting_ = false;
  int bursts_ = 0;                   ///< LearningStatus
  int lights_ = 0;                   ///< likewise
  std::int64_t grew_ns_ = 0;         ///< media time at which there was a keyframe more
  std::size_t keyframes_tried_ = 0;  ///< so many were there when a solve began
  std::int64_t tried_ns_ = 0;        ///< media time of that

  std::atomic<bool> stopping_{false};
  Mutex mutex_;
  std::optional<Solved> solved_ FACET_GUARDED_BY(mutex_);
  bool solving_ = false;     ///< until solved_ was taken
  bool of_another_ = false;  ///< who is solved for is not there any more
  std::jthread solver_;      ///< last: ended before what it reads
};

}  // namespace facet::pipeline
