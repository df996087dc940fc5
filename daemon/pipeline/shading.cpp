#include "pipeline/shading.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <optional>
#include <utility>
#include <vector>

#include "face/face_parts.hpp"
#include "face/subject_builder.hpp"
#include "facet/clock.hpp"
#include "person/skin_follower.hpp"
#include "pipeline/bounded_queue.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/pipeline_board.hpp"
#include "pipeline/workers.hpp"

namespace facet::pipeline {
namespace {

/// How long capture waits for a frame before it looks whether to stop.
constexpr std::chrono::milliseconds kCaptureTimeout{50};
/// Frames decoded ahead of the tracker, recorded sources.
constexpr std::size_t kRecordedQueue = 4;
/// A live frame waits for the tracker alone; the next one replaces it.
constexpr std::size_t kLiveQueue = 1;
/// Share of a live camera's frame interval that refinement may take; the rest is for handing the mesh out.
constexpr double kRefineShare = 0.9;

/// The workers, as Progress counts them.
constexpr std::size_t kCapture = 0;
constexpr std::size_t kTrack = 1;
constexpr std::size_t kRefine = 2;

struct Captured {
  FrameSet set;
  Clock::time_point delivered;
  float capture_ms = 0;

  const Frame& reference() const { return set.frames.front(); }
  bool several() const { return set.frames.size() > 1; }
};

struct Tracked {
  Captured captured;
  std::shared_ptr<mesh::MeshFrame> mesh;
  std::uint32_t subject_count = 0;                     ///< TrackResult::subject
  std::shared_ptr<const std::vector<float>> identity;  ///< of that subject
  std::shared_ptr<const face::FaceModel> model;        ///< that is followed
  std::vector<std::uint8_t> view_used;                 ///< TrackResult::view_used where there are several
};

void degrade(mesh::MeshFrame& mesh, const std::string& reason) {
  mesh.degraded_reason += (mesh.degraded ? "; " : "") + reason;
  mesh.degraded = true;
}

}  // namespace

struct ShadingPipeline::Impl {
  Impl(ShadingParts given, const Options& given_options, std::vector<MeshSink*> given_sinks)
      : stages(std::move(given)),
        options(given_options),
        sinks(std::move(given_sinks)),
        cameras(stages.pictures->cameras()),
        source(cameras.front().info),
        captured(source.live ? kLiveQueue : kRecordedQueue),
        tracked(1),
        refiner(std::move(stages.refiner), stages.open_refiner, messages, given_options.pauses) {
    for (std::size_t i = 1; i < cameras.size(); ++i) {
      further_views.push_back(
          {{}, cameras[i].info.intrinsics.value(), cameras[i].camera_from_reference.value().cast<float>()});
    }
    if (options.hand_on_pictures && cameras.size() == 1) {
      // Of several calibrated cameras the pictures have no distortion any more: mode "frames" records those.
      camera_names = std::make_shared<const std::vector<std::string>>(1, "camera");
    }
    board.change([&](PipelineStatus& shown) {
      shown.source = source;
      shown.device = refiner.device();
    });
  }

  // Set before the threads start.
  ShadingParts stages;
  Options options;
  std::vector<MeshSink*> sinks;
  std::vector<PictureCamera> cameras;
  CameraInfo source;                                             ///< the reference camera's
  std::shared_ptr<const std::vector<std::string>> camera_names;  ///< null: pictures are not handed on

  // facet-capture until it closes `captured`, then facet-refine.
  std::optional<Error> source_failure;

  // Shared by the threads.
  Messages messages;
  Workers workers{{"facet-capture", "facet-track", "facet-refine"},
                  [this](ErrorKind kind, const std::string& what) { fail(kind, what); }};
  std::atomic<bool> stopping{false};
  std::atomic<bool> wants_new_identity{false};
  std::atomic<bool> wants_burst{false};
  BoundedQueue<Captured> captured;
  BoundedQueue<Tracked> tracked;
  FramePool pool;
  Pool<FrameSet> handed_on;
  PipelineBoard board;

  // facet-capture only.
  CameraState camera_state = CameraState::Idle;
  std::string camera_reason;

  // facet-track only.
  std::uint64_t next_sequence = 0;
  std::uint32_t skin_subject = 0;    ///< TrackResult::subject that `skin` follows
  std::uint32_t identity_count = 0;  ///< TrackResult::subject that `identity` belongs to
  std::shared_ptr<const std::vector<float>> identity;
  std::shared_ptr<const face::FaceModel> model;
  std::string learned_note;                        ///< of the person, as it was last logged
  std::shared_ptr<const LearningStatus> learning;  ///< as it was last shown
  std::unique_ptr<person::SkinFollower> skin;      ///< where skin_model knows the skin's albedo
  std::shared_ptr<const face::FaceModel> skin_model;

  // facet-refine only.
  refine::RecoveringRefiner refiner;
  refine::RefineOutput refined;
  std::vector<refine::FurtherCamera> further_views;
  std::shared_ptr<const mesh::Subject> provisional_subject;  ///< of everybody who is not known yet
  std::shared_ptr<const mesh::Subject> subject;
  std::uint32_t subject_count = 0;  ///< TrackResult::subject that `subject` was built for
  std::string given_up;             ///< RefineOutput::given_up of the last refined frame
  bool face_was_away = false;       ///< since the last frame with a mesh

  void fail(ErrorKind kind, const std::string& what);

  void capture();
  void capture_until_end();
  void note_early_end(const std::string& error);
  void note_camera();
  bool take(Captured&& item);
  void track();
  void note_model();
  void track_one(Captured&& item);
  void fill(mesh::MeshFrame& mesh, const Captured& item, const track::TrackResult& result) const;
  void follow_skin(mesh::MeshFrame& mesh, const Captured& item, const track::TrackResult& result);
  void refine();
  void refine_one(Tracked& item);
  void add_provisional_subject(const Tracked& item);
  void follow_subject(const Tracked& item);
  void add_displacements(Tracked& item);
  void note_given_up();
  void hand_out(Tracked& item);
};

void ShadingPipeline::Impl::fail(ErrorKind kind, const std::string& what) {
  board.fail(kind, what);
  stopping = true;
  captured.close();
  tracked.close();
}

void ShadingPipeline::Impl::capture() {
  stages.pictures->start();
  capture_until_end();
  stages.pictures->stop();
  captured.close();
}

void ShadingPipeline::Impl::capture_until_end() {
  while (!stopping) {
    workers.beat(kCapture);
    Captured item;
    const Clock::time_point begun = Clock::now();
    const CaptureOutcome outcome = stages.pictures->next(item.set, kCaptureTimeout);
    note_camera();
    if (outcome == CaptureOutcome::Failed) {
      source_failure.emplace(ErrorKind::UnreadableInput, stages.pictures->last_error());
      return;
    }
    if (outcome == CaptureOutcome::EndOfStream) {
      note_early_end(stages.pictures->last_error());
      return;
    }
    if (outcome == CaptureOutcome::Timeout) {
      continue;
    }
    if (item.set.slot < options.frames.first) {
      continue;
    }
    if (item.set.slot >= options.frames.end) {
      return;
    }
    item.delivered = Clock::now();
    // Of a live source this time is mostly that of waiting for the next exposure.
    item.capture_ms =
        source.live ? 0.0F : std::chrono::duration<float, std::milli>(item.delivered - begun).count();
    board.change([so_far = item.set.slot + 1 - options.frames.first](PipelineStatus& shown) {
      shown.captured = so_far;
    });
    if (!take(std::move(item))) {
      return;
    }
  }
}

/// error: of the source, empty where it is simply at its end.
void ShadingPipeline::Impl::note_early_end(const std::string& error) {
  if (!error.empty()) {
    messages.warning(error);
    board.change([&](PipelineStatus& shown) { shown.reason = error; });
  }
}

/// Says in the log what became of a live source.
void ShadingPipeline::Impl::note_camera() {
  if (!source.live) {
    return;
  }
  const CameraStatus now = stages.pictures->status();
  if (now.state == camera_state && now.reason == camera_reason) {
    return;
  }
  camera_state = now.state;
  camera_reason = now.reason;
  if (now.reason.empty()) {
    messages.info(fmt::format("camera {}", to_string(now.state)));
  } else {
    messages.warning(fmt::format("camera {}: {}", to_string(now.state), now.reason));
  }
}

bool ShadingPipeline::Impl::take(Captured&& item) {
  return source.live ? captured.push_newest(std::move(item))
                     : captured.push(std::move(item), [this] { workers.beat(kCapture); });
}

void ShadingPipeline::Impl::track() {
  board.set_state(PipelineState::Preparing);
  const auto beat = [this] { workers.beat(kTrack); };
  stages.coarse->prepare([&] {
    beat();
    return !stopping;
  });
  note_model();
  board.set_state(PipelineState::Running);
  next_sequence = options.frames.first;
  // A frame is taken only when the GPU has begun the one before: what waits is the newest, not a tracked one.
  while (!stopping && tracked.wait_until_empty(beat)) {
    Captured item;
    if (!captured.pop(item, beat)) {
      break;
    }
    beat();
    if (wants_new_identity.exchange(false)) {
      stages.coarse->reset_identity();
    }
    if (wants_burst.exchange(false)) {
      stages.coarse->burst();
    }
    track_one(std::move(item));
  }
  tracked.close();
}

/// Says in the log what was learned of the person.
void ShadingPipeline::Impl::note_model() {
  const LearnedPerson& learned = stages.coarse->learned();
  model = learned.model != nullptr ? learned.model : stages.model;
  if (learned.note != learned_note) {
    learned_note = learned.note;
    if (!learned_note.empty()) {
      messages.info(learned_note);
    }
  }
  if (learned.learning != learning) {
    learning = learned.learning;
    board.change([&](PipelineStatus& shown) { shown.learning = learning; });
  }
}

void ShadingPipeline::Impl::track_one(Captured&& item) {
  // What a recorded source leaves out was not there.
  if (source.live && item.set.slot > next_sequence) {
    board.change(
        [left_out = item.set.slot - next_sequence](PipelineStatus& shown) { shown.dropped += left_out; });
  }
  next_sequence = item.set.slot + 1;
  stages.coarse->keep_model(
      std::any_of(sinks.begin(), sinks.end(), [](const MeshSink* sink) { return sink->wants_one_mesh(); }));
  const track::TrackResult& result = stages.coarse->process(item.set.frames);
  note_model();
  if (identity == nullptr || identity_count != result.subject) {
    identity = std::make_shared<const std::vector<float>>(result.identity);
    identity_count = result.subject;
  }
  Tracked tracked_item;
  tracked_item.mesh = pool.take();
  tracked_item.subject_count = result.subject;
  tracked_item.identity = identity;
  tracked_item.model = model;
  if (item.several()) {
    tracked_item.view_used = result.view_used;
  }
  fill(*tracked_item.mesh, item, result);
  if (camera_names != nullptr) {
    const std::shared_ptr<FrameSet> set = handed_on.take();
    *set = item.set;
    set->camera_names = camera_names;
    tracked_item.mesh->images = set;
  }
  follow_skin(*tracked_item.mesh, item, result);
  tracked_item.captured = std::move(item);
  tracked.push(std::move(tracked_item), [this] { workers.beat(kTrack); });
}

void ShadingPipeline::Impl::fill(mesh::MeshFrame& mesh, const Captured& item,
                                 const track::TrackResult& result) const {
  mesh.sequence = item.set.slot;
  mesh.timestamp_ns = item.set.trigger_ns;
  mesh.media_time_ns = item.set.media_time_ns;
  mesh.state = result.state;
  mesh.camera = result.camera;
  mesh.landmarks_px.assign(result.landmarks_px.begin(), result.landmarks_px.end());
  mesh.stage_ms.capture_ms = item.capture_ms;
  mesh.stage_ms.detect_ms = result.detect_ms;
  mesh.stage_ms.landmarks_ms = result.landmarks_ms;
  mesh.stage_ms.fit_ms = result.fit_ms;
  if (item.reference().corrupt) {
    degrade(mesh, "the source says that the image is damaged");
  }
  for (std::size_t i = 0; i < item.set.frames.size(); ++i) {
    if (item.set.frames[i].empty()) {
      degrade(mesh, "no picture of camera " + cameras[i].info.name);
    }
  }
  if (!result.has_mesh) {
    mesh.control_vertices_mm.resize(3, 0);
    return;
  }
  mesh.camera_from_head = result.camera_from_head;
  const bool read = !result.values.empty() && result.values != result.expression;
  const std::vector<float>& values = read ? result.values : result.expression;
  mesh.expression.assign(values.begin(), values.end());
  mesh.expression_confidence.assign(result.value_confidence.begin(), result.value_confidence.end());
  mesh.model_weights.clear();
  if (read) {
    mesh.model_weights.assign(result.expression.begin(), result.expression.end());
  }
  mesh.reprojection_px = result.reprojection_px;
  mesh.control_vertices_mm = result.vertices_mm;
}

/// Brings the head of a person whose skin is known to where the reference camera shows it.
void ShadingPipeline::Impl::follow_skin(mesh::MeshFrame& mesh, const Captured& item,
                                        const track::TrackResult& result) {
  if (skin_model != model) {
    skin.reset();
    skin_model = model;
    try {
      if (!model->skin.albedo.empty()) {
        using Pace = person::SkinFollower::Pace;
        skin = std::make_unique<person::SkinFollower>(*model, source.live ? Pace::Beside : Pace::EveryFrame);
      }
    } catch (const std::exception& error) {
      messages.warning(fmt::format("the skin is not followed: {}", error.what()));
    }
  }
  if (skin == nullptr) {
    return;
  }
  if (result.state != mesh::TrackingState::Tracking || result.subject != skin_subject) {
    skin_subject = result.subject;
    skin->forget();
  }
  if (result.state != mesh::TrackingState::Tracking) {
    return;
  }
  const bool seen = (result.view_used.empty() || result.view_used.front() != 0) && !item.reference().corrupt;
  const Clock::time_point begun = Clock::now();
  try {
    person::FollowedHead followed;
    skin->follow(seen ? item.reference() : Frame{}, result, followed);
    mesh.camera_from_head = followed.camera_from_head;
    mesh.control_vertices_mm = followed.vertices_mm;
  } catch (const std::exception& error) {
    degrade(mesh, fmt::format("the skin was not followed: {}", error.what()));
  }
  mesh.stage_ms.fit_ms += std::chrono::duration<float, std::milli>(Clock::now() - begun).count();
}

void ShadingPipeline::Impl::refine() {
  Tracked item;
  const auto beat = [this] { workers.beat(kRefine); };
  while (tracked.pop(item, beat)) {
    beat();
    if (stopping) {
      continue;  // what was tracked when the stop came is let go
    }
    refine_one(item);
    hand_out(item);
    item = {};
  }
  if (!stopping && source_failure) {
    // Only now: what came before the failure is handed out.
    throw Error(*source_failure);
  }
  board.set_state(stopping ? PipelineState::Stopped : PipelineState::Ended);
}

void ShadingPipeline::Impl::refine_one(Tracked& item) {
  if (item.mesh->state != mesh::TrackingState::Tracking) {
    face_was_away = true;
    if (item.mesh->control_vertices_mm.cols() > 0) {
      add_provisional_subject(item);
    }
    return;
  }
  if (subject == nullptr || subject_count != item.subject_count) {
    follow_subject(item);
  } else if (face_was_away) {
    refiner.restart();
  }
  face_was_away = false;
  item.mesh->subject = subject;
  if (!item.captured.reference().corrupt || !further_views.empty()) {
    add_displacements(item);
  }
}

/// While the identity is being estimated the mesh is coarse and its topology M0, which is the same for
/// everybody.
void ShadingPipeline::Impl::add_provisional_subject(const Tracked& item) {
  if (provisional_subject == nullptr) {
    mesh::HierarchyOptions control_alone = options.hierarchy;
    control_alone.max_levels = 1;
    const std::vector<float> unknown(static_cast<std::size_t>(item.model->identity_count()));
    provisional_subject =
        face::build_subject(*item.model, control_alone, *item.mesh, unknown, 0, stages.person);
  }
  item.mesh->subject = provisional_subject;
}

void ShadingPipeline::Impl::follow_subject(const Tracked& item) {
  subject = face::build_subject(*item.model, options.hierarchy, *item.mesh, *item.identity,
                                item.subject_count, stages.person);
  subject_count = item.subject_count;
  const mesh::Hierarchy& hierarchy = *subject->hierarchy;
  board.change([&](PipelineStatus& shown) {
    ++shown.subjects;
    shown.finest_vertices = hierarchy.finest().vertex_count;
    shown.levels = static_cast<int>(hierarchy.levels.size());
  });
  messages.info(fmt::format("subject {}: hierarchy of {} levels, {} to {} vertices", item.subject_count,
                            hierarchy.levels.size(), hierarchy.levels.front().vertex_count,
                            hierarchy.finest().vertex_count));
  face::KnownSkin known = face::known_skin(*item.model, hierarchy);
  refiner.set_subject({.hierarchy = subject->hierarchy,
                       .mean_albedo = item.model->mean_albedo,
                       .refinable = item.model->control.refinable,
                       .trust = face::shading_trust(*item.model),
                       .known_shape = item.model->identity_count() == 0,
                       .relief_mm = std::move(known.relief_mm),
                       .skin_albedo = std::move(known.albedo)});
}

void ShadingPipeline::Impl::add_displacements(Tracked& item) {
  mesh::MeshFrame& mesh = *item.mesh;
  refine::RefineInput input;
  const std::vector<Frame>& pictures = item.captured.set.frames;
  input.image = pictures.front().corrupt ? Frame{} : pictures.front();
  input.camera = mesh.camera;
  input.camera_from_head = mesh.camera_from_head;
  input.control_vertices_mm = &mesh.control_vertices_mm;
  for (std::size_t v = 0; v < further_views.size(); ++v) {
    // Where the landmarks were not believed something may stand before the face.
    const Frame& picture = pictures[v + 1];
    further_views[v].image = item.view_used[v + 1] != 0 && !picture.corrupt ? picture : Frame{};
  }
  input.further_views = further_views;
  input.image_counts = further_views.empty() || item.view_used.front() != 0;
  if (source.live && source.rate_hz > 0) {
    input.time_limit_ms = static_cast<float>(kRefineShare * 1000 / source.rate_hz);
  }
  const std::string& missing = refiner.refine(input, refined);
  if (!missing.empty()) {
    degrade(mesh, missing);
    return;
  }
  note_given_up();
  // The frame's own buffers come back with the next result.
  mesh.displacements_mm.swap(refined.displacements_mm);
  mesh.confidence.swap(refined.confidence);
  mesh.lighting = refined.lighting;
  mesh.albedo = refined.albedo;
  mesh.photometric_rms = refined.photometric_rms;
  mesh.stage_ms.upload_ms = refined.upload_ms;
  mesh.stage_ms.lighting_ms = refined.lighting_ms;
  mesh.stage_ms.albedo_ms = refined.albedo_ms;
  mesh.stage_ms.displacement_ms = refined.displacement_ms;
  mesh.stage_ms.readback_ms = refined.readback_ms;
}

/// Says in the log what refinement leaves out from now on to hold the camera's rate.
void ShadingPipeline::Impl::note_given_up() {
  if (refined.given_up == given_up) {
    return;
  }
  given_up = refined.given_up;
  messages.info(given_up.empty() ? "refinement: all levels again" : "refinement: " + given_up);
  board.change([&](PipelineStatus& shown) { shown.given_up = given_up; });
}

void ShadingPipeline::Impl::hand_out(Tracked& item) {
  mesh::MeshFrame& mesh = *item.mesh;
  mesh.stage_ms.latency_ms = ms_since(item.captured.delivered);
  for (MeshSink* sink : sinks) {
    sink->complete(mesh);
  }
  for (MeshSink* sink : sinks) {
    sink->deliver(item.mesh);
  }
  board.change([&](PipelineStatus& shown) { shown.device = refiner.device(); });
  board.count(mesh, !mesh.landmarks_px.empty());
}

ShadingPipeline::ShadingPipeline(ShadingParts stages, const Options& options, std::vector<MeshSink*> sinks)
    : impl_(std::make_unique<Impl>(std::move(stages), options, std::move(sinks))) {}

ShadingPipeline::~ShadingPipeline() {
  stop();
}

void ShadingPipeline::start() {
  impl_->board.set_state(PipelineState::Preparing);
  Impl& impl = *impl_;
  impl.workers.begin({{kRefine, [&impl] { impl.refine(); }},
                      {kTrack, [&impl] { impl.track(); }},
                      {kCapture, [&impl] { impl.capture(); }}});
}

void ShadingPipeline::request_stop() {
  impl_->stopping = true;
  impl_->captured.close();
  impl_->tracked.close();
  impl_->stages.coarse->request_stop();
  impl_->refiner.request_stop();
}

void ShadingPipeline::stop() {
  request_stop();
  impl_->workers.join();
}

bool ShadingPipeline::finished() const {
  return impl_->workers.finished();
}

PipelineStatus ShadingPipeline::status() const {
  PipelineStatus status = impl_->board.status();
  status.camera = impl_->stages.pictures->status();
  status.queued_captured = impl_->captured.size();
  status.queued_tracked = impl_->tracked.size();
  return status;
}

std::optional<Progress::Silence> ShadingPipeline::longest_silence() const {
  return impl_->workers.progress().longest_silence();
}

void ShadingPipeline::reset_identity() {
  impl_->wants_new_identity = true;
}

void ShadingPipeline::burst() {
  impl_->wants_burst = true;
}

std::vector<Messages::Message> ShadingPipeline::take_messages() {
  return impl_->messages.take();
}

}  // namespace facet::pipeline
