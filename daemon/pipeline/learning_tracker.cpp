#include "pipeline/learning_tracker.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <new>
#include <system_error>
#include <utility>
#include <vector>

#include "face/person_model.hpp"
#include "person/person_file.hpp"

namespace facet::pipeline {
namespace {

/// No new orientation was seen for this long: the head has done its turning.
constexpr std::int64_t kQuiet_ns = 2'000'000'000;
/// After a solve that was refused the next one has so many times the orientations.
constexpr double kMoreBeforeNext = 1.25;
/// Or so long after it: pictures that took the place of others are not counted.
constexpr std::int64_t kLongestRest_ns = 120'000'000'000;
/// So many of the keyframes, the most frontal, are shown so often until it is known how well the landmarks
/// fit.
constexpr std::size_t kInFront = 3;
constexpr int kTimesToFit = 4;
/// Frames come first: of a processor that they want this thread gets a tenth.
constexpr int kNice = 10;

}  // namespace

LearnedFace learn_face(const face::FaceModel& model, const person::Observed& observed,
                       const LearnOptions& options, const std::string& from,
                       const std::function<bool()>& go_on) {
  LearnedFace out;
  try {
    out.shape = person::learn_shape(model, observed, options.enrolment, [&](int, int) { return go_on(); });
    const person::LearnedShape& shape = out.shape;
    if (!go_on()) {
      return out;
    }
    if (!shape.accepted) {
      out.note = "the head turns, but its shape was not learned: " + shape.refused;
      return out;
    }
    out.camera = observed.camera;
    if (!options.enrolment.focal_is_known) {
      out.camera.fx = out.camera.fy = static_cast<float>(shape.focal_px);
    }
    out.note = fmt::format(
        "the head turns: its own shape is followed, learned from {} pictures of {}{} (focal length {:.0f} "
        "px)",
        shape.keyframes.size(), from,
        observed.burst.empty() ? "" : fmt::format(" and a burst of {} lights", observed.light_count()),
        shape.focal_px);
    face::FaceModel own = face::person_model(model, shape.identity, shape.neutral_mm, "learned from " + from);
    if (shape.skin.believed) {
      own.skin = shape.skin.chart;
      track::TrackerConfig tracker = options.tracker;
      tracker.intrinsics = out.camera;
      // That of a burst is nearer as it is.
      const std::string missed = observed.burst.empty()
                                     ? refine_relief(own, observed, tracker, options.relief, go_on)
                                     : std::string();
      if (!missed.empty()) {
        out.note += "; " + missed;
      }
      out.shape.skin.chart = own.skin;
    } else if (!shape.skin_note.empty()) {
      out.note += "; " + shape.skin_note;
    }
    out.model = std::make_shared<const face::FaceModel>(std::move(own));
  } catch (const std::exception& error) {
    out.note = fmt::format("the head turns, but its shape was not learned: {}", error.what());
  }
  return out;
}

LearningTracker::LearningTracker(std::shared_ptr<const face::FaceModel> model,
                                 const track::TrackerConfig& config, ReliefRefinement relief,
                                 std::unique_ptr<LampBurst> lamps)
    : generic_model_(std::move(model)),
      config_(config),
      relief_(std::move(relief)),
      generic_(*generic_model_, config),
      keyframes_(*generic_model_),
      lamps_(std::move(lamps)) {
  show(LearningStatus::State::Looking);
}

LearningTracker::~LearningTracker() = default;

const track::TrackResult& LearningTracker::process(std::span<const Frame> views) {
  take_solved();
  if (own_ != nullptr) {
    follow(*own_, views);
    if (result_.state != mesh::TrackingState::Acquiring) {
      return result_;
    }
    leave_person();  // its tracker found that this is somebody else
  }
  const std::uint32_t subject = result_.subject;
  follow(generic_, views);
  if (result_.state == mesh::TrackingState::Acquiring || result_.subject != subject) {
    forget();  // what was seen is of somebody else
  }
  try {
    look(views.front());
  } catch (const std::bad_alloc&) {
    forget();
    learned_.note = "no memory is left to learn the head's shape";
  }
  return result_;
}

void LearningTracker::follow(track::Tracker& tracker, std::span<const Frame> views) {
  result_ = tracker.process(views);
  result_.subject += subjects_before_;
}

void LearningTracker::reset_identity() {
  leave_person();
}

void LearningTracker::burst() {
  burst_wanted_ = lamps_ != nullptr && !bursting_ && own_ == nullptr && !solving_ &&
                  result_.state == mesh::TrackingState::Tracking;
}

/// Whoever comes next is estimated anew.
void LearningTracker::leave_person() {
  if (own_ != nullptr) {
    own_.reset();
    learned_.model = nullptr;
    // The generic tracker's next subject is the next of all.
    subjects_before_ = result_.subject - generic_.subjects();
  }
  generic_.reset_identity();
  forget();
}

/// Of what was seen nothing is left, and what is being solved counts no more.
void LearningTracker::forget() {
  burst_wanted_ = false;
  if (std::exchange(bursting_, false)) {
    lamps_->end();
  }
  if (keyframes_.size() == 0 && bursts_ == 0 && (!solving_ || of_another_) && learned_.note.empty() &&
      learned_.learning->state == LearningStatus::State::Looking) {
    return;
  }
  keyframes_.clear();
  keyframes_seen_ = 0;
  keyframes_tried_ = 0;
  bursts_ = 0;
  lights_ = 0;
  learned_.note.clear();
  solver_.request_stop();
  of_another_ = solving_;
  show(LearningStatus::State::Looking);
}

/// Makes what the head has shown and what became of it visible.
void LearningTracker::show(LearningStatus::State state) {
  auto now = std::make_shared<LearningStatus>();
  now->state = state;
  now->note = learned_.note;
  now->subject = result_.subject;
  for (const auto& [yaw, pitch] : keyframes_.filled()) {
    now->seen_deg.push_back({static_cast<float>(yaw), static_cast<float>(pitch)});
  }
  const person::OrientationSpan span = keyframes_.span();
  now->turned_left_deg = static_cast<float>(std::abs(span.least_yaw));
  now->turned_right_deg = static_cast<float>(span.largest_yaw);
  now->needed_deg = static_cast<float>(person::kLeastYawDeg);
  now->lamps = lamps_ != nullptr ? lamps_->count() : 0;
  now->burst_s = lamps_ != nullptr ? static_cast<float>(lamps_->duration_s()) : 0;
  now->bursts = bursts_;
  now->lights = lights_;
  learned_.learning = std::move(now);
}

/// A picture of a burst, which ends with it or goes on.
void LearningTracker::look_at_lit(const Frame& picture) {
  keyframes_.offer_lit(result_, picture);
  bursting_ = lamps_->go_on(picture.media_time_ns);
  if (bursting_) {
    return;
  }
  ++bursts_;
  grew_ns_ = picture.media_time_ns;
  const person::EnrolmentOptions how;
  const std::optional<person::Observed> observed = keyframes_.observed(how.keyframes, how.lit);
  lights_ = observed ? observed->light_count() : 0;
  if (lights_ < 2) {
    keyframes_.clear_lit();  // nothing of it tells lights apart
  }
  learned_.note.clear();
  if (!lamps_->fault().empty()) {
    learned_.note = "the lamps can't be switched: " + lamps_->fault();
  } else if (lights_ < 2) {
    learned_.note = "the lamps fired, but the face, at rest and still, was not seen under two lights";
  }
  show(learned_.learning->state);
}

void LearningTracker::look(const Frame& picture) {
  if (std::exchange(burst_wanted_, false)) {
    keyframes_.clear_lit();
    lamps_->begin(picture.media_time_ns);
    bursting_ = true;
  }
  if (bursting_) {
    look_at_lit(picture);
    return;
  }
  keyframes_.offer(result_, picture);
  if (keyframes_.size() != keyframes_seen_) {
    keyframes_seen_ = keyframes_.size();
    grew_ns_ = picture.media_time_ns;
    show(learned_.learning->state);
  } else {
    begin_when_enough(picture.media_time_ns);
  }
}

void LearningTracker::begin_when_enough(std::int64_t media_time_ns) {
  const std::size_t seen = keyframes_seen_;
  const bool more = static_cast<double>(seen) >= kMoreBeforeNext * static_cast<double>(keyframes_tried_) ||
                    media_time_ns - tried_ns_ >= kLongestRest_ns;  // pictures get calmer, too
  if (solving_ || seen == 0 || media_time_ns - grew_ns_ < kQuiet_ns || (keyframes_tried_ > 0 && !more) ||
      !person::turned_enough(keyframes_.span())) {
    return;
  }
  keyframes_tried_ = seen;
  tried_ns_ = media_time_ns;
  std::optional<person::Observed> observed =
      keyframes_.observed(person::EnrolmentOptions().keyframes, person::EnrolmentOptions().lit);
  if (!observed) {
    learned_.note = "the head turns, but no picture shows the face at rest";
    show(LearningStatus::State::Looking);
    return;
  }
  learned_.note.clear();
  try {
    solver_ = std::jthread([this, shown = std::move(*observed)](const std::stop_token& stop) {
      solve([&] { return !stop.stop_requested() && !stopping_; }, shown);
    });
    solving_ = true;
    of_another_ = false;
  } catch (const std::system_error& error) {
    learned_.note =
        fmt::format("the head turns, but there is no thread to learn its shape: {}", error.code().message());
  }
  show(solving_ ? LearningStatus::State::Solving : LearningStatus::State::Looking);
}

/// On the solver's thread.
void LearningTracker::solve(const std::function<bool()>& go_on, const person::Observed& observed) {
  ::pthread_setname_np(::pthread_self(), "facet-learn");
  [[maybe_unused]] const int ignored = ::nice(kNice);  // refused, it is as important as the others
  Solved solved;
  try {
    LearnOptions how{{}, config_, relief_};
    how.enrolment.focal_is_known = config_.intrinsics.has_value();
    solved.face = learn_face(*generic_model_, observed, how, "this session", go_on);
    if (solved.face.model != nullptr) {
      solved.person = std::make_shared<const person::PersonFile>(
          person::person_of(*generic_model_, observed, solved.face.shape));
      solved.face.shape.skin = {};  // the model and the person have it
      solved.tracker = follower_of(solved.face, observed, go_on);
      if (solved.tracker == nullptr) {
        solved.face.note = "the head turns, but with the shape learned it could not be followed";
      }
    }
  } catch (const std::exception&) {
    solved.tracker.reset();
    solved.face.note.clear();  // want of memory leaves none for words: take_solved finds them
  }
  const Lock lock(mutex_);
  solved_ = std::move(solved);
}

/// A tracker that knows the face: who it is, how its landmarks lie and how well they fit was estimated from
/// the keyframes. Null where they don't show a face to it, or it was broken off.
std::unique_ptr<track::Tracker> LearningTracker::follower_of(const LearnedFace& face,
                                                             const person::Observed& observed,
                                                             const std::function<bool()>& go_on) const {
  track::TrackerConfig config = config_;
  config.intrinsics = face.camera;
  auto follower = std::make_unique<track::Tracker>(*face.model, config);
  config.live = false;
  track::Tracker acquirer(*face.model, config);
  std::int64_t now_ns = 0;
  const auto show_keyframe = [&](const person::Keyframe& keyframe) {
    if (go_on()) {
      Frame picture = person::picture_of(keyframe, observed.camera);
      picture.media_time_ns = now_ns += kKeyframeStep_ns;
      acquirer.process(picture);
    }
  };
  std::for_each(observed.keyframes.begin(), observed.keyframes.end(), show_keyframe);
  acquirer.settle_subject();
  // How well the landmarks of this face fit it, by which somebody else is known, is what they do in front.
  std::vector<const person::Keyframe*> in_front;
  for (const person::Keyframe& keyframe : observed.keyframes) {
    in_front.push_back(&keyframe);
  }
  const auto turned_deg = [](const person::Keyframe* keyframe) {
    return std::hypot(keyframe->yaw_deg, keyframe->pitch_deg);
  };
  std::sort(in_front.begin(), in_front.end(),
            [&](const auto* a, const auto* b) { return turned_deg(a) < turned_deg(b); });
  in_front.resize(std::min(in_front.size(), kInFront));
  for (int time = 0; time < kTimesToFit; ++time) {
    for (const person::Keyframe* keyframe : in_front) {
      show_keyframe(*keyframe);
    }
  }
  const std::optional<track::Person> person = acquirer.person();
  if (!person || !go_on()) {
    return nullptr;
  }
  follower->adopt(*person, observed.camera.width_px, observed.camera.height_px);
  return follower;
}

/// Follows the face that was learned from now on, if it is the one that is seen.
void LearningTracker::take_solved() {
  if (!solving_) {
    return;
  }
  std::optional<Solved> solved;
  {
    const Lock lock(mutex_);
    const bool waits = solved_ && solved_->tracker != nullptr && !of_another_ &&
                       (keep_model_ || result_.state != mesh::TrackingState::Tracking);
    if (waits && keep_model_ && learned_.note.empty()) {
      learned_.note = "the head turned and its own shape was found: it waits for the end of the take";
      show(LearningStatus::State::Solving);
    }
    if (!solved_ || waits) {
      return;
    }
    solved.swap(solved_);
  }
  solver_.join();
  solving_ = false;
  if (of_another_) {
    of_another_ = false;
    return;
  }
  learned_.note = std::move(solved->face.note);
  if (solved->tracker == nullptr) {
    if (learned_.note.empty()) {
      learned_.note = "the head turns, but memory ran out while its shape was learned";
    }
    show(LearningStatus::State::Looking);
    return;
  }
  learned_.model = std::move(solved->face.model);
  own_ = std::move(solved->tracker);
  subjects_before_ = result_.subject;
  auto now = std::make_shared<LearningStatus>(*learned_.learning);
  now->state = LearningStatus::State::Learned;
  now->note.clear();
  now->subject = result_.subject + 1;  // as the first frame with it will say
  now->person = std::move(solved->person);
  learned_.learning = std::move(now);
  keyframes_.clear();
  keyframes_seen_ = 0;
  keyframes_tried_ = 0;
}

}  // namespace facet::pipeline
