#include "pipeline/shading_parts.hpp"

#include <fmt/format.h>

#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "person/enrolment.hpp"
#include "person/keyframes.hpp"
#include "person/person_file.hpp"
#include "person/person_folder.hpp"
#include "pipeline/learning_tracker.hpp"

namespace facet::pipeline {
namespace {

/// Frames of a recording that are looked at ahead for the subject: beyond these it is estimated on the way.
constexpr std::uint64_t kMostFramesAhead = 3000;

class TrackerStage final : public CoarseStage {
 public:
  /// open: a recorded source once more, to look ahead; empty for others.
  TrackerStage(std::shared_ptr<const face::FaceModel> model, const ShadingConfig& config, OpenPictures open,
               ReliefRefinement relief)
      : model_(std::move(model)),
        config_(config),
        open_(std::move(open)),
        relief_(std::move(relief)),
        tracker_(make_tracker()) {}

  void prepare(const std::function<bool()>& go_on) override {
    if (!open_) {
      return;
    }
    look_ahead(go_on);
    if (!subject_ || !config_.learn_ahead || !config_.tracker.further_views.empty() ||
        model_->identity_count() == 0) {
      return;
    }
    const std::optional<person::Observed> observed = observe(go_on);
    if (observed && go_on()) {
      learn(*observed, go_on);
    }
    if (learned_.model != nullptr && go_on()) {
      tracker_ = make_tracker();
      look_ahead(go_on);
    }
  }
  const LearnedPerson& learned() const override { return learned_; }
  void keep_model(bool /*keep*/) override {}  // nothing changes after prepare
  const track::TrackResult& process(std::span<const Frame> views) override {
    return tracker_->process(views);
  }
  void reset_identity() override { tracker_->reset_identity(); }
  void request_stop() override {}  // prepare asks whether to go on

 private:
  std::unique_ptr<track::Tracker> make_tracker() const {
    return std::make_unique<track::Tracker>(learned_.model != nullptr ? *learned_.model : *model_,
                                            config_.tracker);
  }

  /// Hands out the frame sets of the range, kMostFramesAhead at most, until `wants` or go_on says no.
  void each_set(const std::function<bool()>& go_on, const std::function<bool(const FrameSet&)>& wants) const {
    const std::unique_ptr<PictureSource> pictures = open_();
    pictures->start();
    FrameSet set;
    for (std::uint64_t seen = 0; seen < kMostFramesAhead && go_on();) {
      const CaptureOutcome outcome = pictures->next(set, std::chrono::milliseconds(100));
      if (outcome == CaptureOutcome::Timeout) {
        continue;
      }
      if (outcome != CaptureOutcome::Delivered || set.slot >= config_.frames.end) {
        return;
      }
      if (set.slot >= config_.frames.first) {
        ++seen;
        if (!wants(set)) {
          return;
        }
      }
    }
  }

  /// Lets the tracker adopt who is first known in the recording.
  void look_ahead(const std::function<bool()>& go_on) {
    const auto ahead = make_tracker();
    each_set(go_on, [&](const FrameSet& set) {
      width_px_ = set.frames.front().width_px;
      height_px_ = set.frames.front().height_px;
      ahead->process(set.frames);
      return !ahead->person();
    });
    if (!go_on()) {
      return;  // the work of a second, for nobody
    }
    ahead->settle_subject();
    subject_ = ahead->person();
    if (subject_) {
      tracker_->adopt(*subject_, width_px_, height_px_);
    }
  }

  /// What the head of who was adopted shows from the recording's first frame on, where nobody else is seen
  /// and it turns far enough to both sides.
  std::optional<person::Observed> observe(const std::function<bool()>& go_on) const {
    const auto tracker = make_tracker();
    tracker->adopt(*subject_, width_px_, height_px_);
    person::KeyframeCollector collector(*model_);
    std::optional<std::uint32_t> first;  // TrackResult::subject
    bool alone = true;
    each_set(go_on, [&](const FrameSet& set) {
      const track::TrackResult& tracked = tracker->process(set.frames);
      first = first.value_or(tracked.subject);
      alone = first == tracked.subject;
      collector.offer(tracked, set.frames.front());
      return alone;
    });
    return alone && person::turned_enough(collector.span())
               ? collector.observed(person::EnrolmentOptions().keyframes)
               : std::nullopt;
  }

  /// What can't be learned leaves the guess in its place.
  void learn(const person::Observed& observed, const std::function<bool()>& go_on) {
    LearnOptions how{{}, config_.tracker, relief_};
    how.enrolment.focal_is_known = config_.tracker.intrinsics.has_value();
    how.enrolment.uncertainty = false;
    LearnedFace face = learn_face(*model_, observed, how, "the recording", go_on);
    learned_.model = std::move(face.model);
    learned_.note = std::move(face.note);
    if (learned_.model != nullptr) {
      config_.tracker.intrinsics = face.camera;
    }
  }

  std::shared_ptr<const face::FaceModel> model_;
  ShadingConfig config_;
  OpenPictures open_;
  ReliefRefinement relief_;
  std::optional<track::Person> subject_;  ///< who was adopted, from pictures of this size:
  int width_px_ = 0;
  int height_px_ = 0;
  LearnedPerson learned_;
  std::unique_ptr<track::Tracker> tracker_;
};

void load_model(const ShadingConfig& config, ShadingParts& parts) {
  auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config.model_file));
  if (!config.person.empty()) {
    const std::filesystem::path file = person::person_file(config.person, config.persons_folder);
    const person::PersonFile person = person::read_person(file);
    model = std::make_shared<const face::FaceModel>(person::model_of(person, *model, file.string()));
    parts.person = person.name;
  }
  // A control mesh that can't be subdivided must be found now, not with the first face.
  mesh::HierarchyOptions coarse_only;
  coarse_only.max_levels = 1;
  const auto count = static_cast<std::size_t>(model->vertex_count());
  try {
    mesh::build_hierarchy(model->control, mesh::TextureCoordinates::Zero(2, model->vertex_count()),
                          std::vector<std::uint8_t>(count, 0), coarse_only);
  } catch (const Error& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: the model's mesh can't be used: {}",
                                                        config.model_file.string(), error.what()));
  }
  parts.model = std::move(model);
}

std::unique_ptr<PictureSource> open_pictures(const ShadingConfig& config) {
  if (config.views.empty()) {
    return one_camera(camera::open_camera(config.source));
  }
  std::vector<std::unique_ptr<Camera>> cameras;
  std::vector<capture::RigCamera> known;
  for (const RecordedCamera& view : config.views) {
    cameras.push_back(camera::open_camera(view.source));
    known.push_back(view.camera);
  }
  return calibrated(cameras_in_step(std::move(cameras)), known, config.views.front().rig_file);
}

}  // namespace

track::TrackerConfig tracker_config(const ShadingConfig& config, const CameraInfo& source) {
  track::TrackerConfig tracker = config.tracker;
  if (!tracker.intrinsics) {
    tracker.intrinsics = source.intrinsics;
  }
  return tracker;
}

ShadingParts open_shading(const ShadingConfig& given, OpenPictures open) {
  ShadingConfig config = given;
  if (!open) {
    open = [config] { return open_pictures(config); };
  }
  ShadingParts stages;
  // Cheap and likely mistakes first.
  stages.pictures = open();
  const std::vector<PictureCamera> cameras = stages.pictures->cameras();
  const PictureCamera& reference = cameras.front();
  if (reference.camera_from_reference) {
    config.tracker.intrinsics.reset();  // the rig file knows
  }
  config.tracker = tracker_config(config, reference.info);
  config.tracker.live = reference.info.live;
  for (std::size_t i = 1; i < cameras.size(); ++i) {
    config.tracker.further_views.push_back(
        {cameras[i].info.intrinsics.value(), cameras[i].camera_from_reference.value()});
  }
  load_model(config, stages);
  ReliefRefinement relief{config.hierarchy, {}};
  if (config.gpu_device != kNoDevice) {
    stages.open_refiner = refine::refiner_opener({.device = config.gpu_device}, config.refiner);
    // What a person's relief is does not depend on how it is to be shown.
    relief.open = refine::refiner_opener({.device = config.gpu_device}, {});
  }
  const bool recorded = !reference.info.live && !config.source.loop;
  if (!recorded && config.learn_live && cameras.size() == 1 && stages.model->identity_count() > 0) {
    stages.coarse = std::make_unique<LearningTracker>(stages.model, config.tracker, std::move(relief),
                                                      open_lamps(config.lamps));
  } else {
    stages.coarse = std::make_unique<TrackerStage>(
        stages.model, config, recorded ? std::move(open) : OpenPictures(), std::move(relief));
  }
  if (stages.open_refiner) {
    stages.refiner = stages.open_refiner();
  }
  return stages;
}

}  // namespace facet::pipeline
