#include "scripted_stages.hpp"

#include <thread>
#include <utility>

#include "facet/error.hpp"
#include "support/synthetic_model.hpp"

namespace facet::test {
namespace {

class ScriptedCamera final : public Camera {
 public:
  explicit ScriptedCamera(Script& script) : script_(script), next_(script.first_sequence) {}

  CameraInfo info() const override {
    CameraInfo info;
    info.name = "scripted";
    info.width_px = 64;
    info.height_px = 48;
    info.rate_hz = 30;
    info.live = script_.live;
    info.frame_count = script_.frame_count;
    return info;
  }
  CameraStatus status() const override {
    const std::lock_guard lock(script_.camera_status_mutex);
    return script_.camera_status;
  }
  void start() override {
    if (script_.throws_at_start) {
      throw Error(ErrorKind::UnreadableInput, "scripted: cannot start");
    }
  }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    if (script_.silent) {
      std::this_thread::sleep_for(timeout);
      return CaptureOutcome::Timeout;
    }
    const auto change = script_.camera_changes.find(next_);
    if (change != script_.camera_changes.end()) {
      const std::lock_guard lock(script_.camera_status_mutex);
      script_.camera_status = change->second;
      script_.camera_changes.erase(change);
      return CaptureOutcome::Timeout;
    }
    script_.camera_gate.pass();
    if (delivered_ == script_.frame_count) {
      error_ = script_.end_note;
      return CaptureOutcome::EndOfStream;
    }
    if (next_ == script_.fails_at) {
      error_ = "scripted: the cable is out";
      return CaptureOutcome::Failed;
    }
    out.sequence = next_;
    out.timestamp_ns = static_cast<std::int64_t>(next_) * 33'000'000;
    out.media_time_ns = out.timestamp_ns;
    out.width_px = 64;
    out.height_px = 48;
    out.stride_bytes = 256;
    out.corrupt = next_ == script_.corrupt_at;
    out.pixels = pixels_;
    next_ += script_.sequence_step;
    ++delivered_;
    return CaptureOutcome::Delivered;
  }
  void stop() override { script_.camera_stopped = true; }
  std::string last_error() const override { return error_; }

 private:
  Script& script_;
  std::uint64_t next_;
  std::uint64_t delivered_ = 0;
  std::string error_;
  std::shared_ptr<const std::uint8_t[]> pixels_ = std::make_shared<std::uint8_t[]>(256 * 48);
};

class ScriptedTracker final : public pipeline::CoarseStage {
 public:
  explicit ScriptedTracker(Script& script) : script_(script) {
    const auto& model = *script.model;
    result_.identity.assign(static_cast<std::size_t>(model.identity_count()), 0.5F);
    result_.expression.assign(static_cast<std::size_t>(model.expression_count()), 0.25F);
    result_.camera = {100, 100, 31.5F, 23.5F, 64, 48};
    // Head frame: y up, z out of the face; camera frame: y down, z forward.
    result_.camera_from_head.linear() = Eigen::Vector3f(1, -1, -1).asDiagonal();
    result_.camera_from_head.translation() << 0, 0, 600;
  }
  void prepare(const std::function<bool()>& go_on) override {
    script_.preparing = true;
    while (script_.prepare_waits_for_stop && go_on()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }
  const pipeline::LearnedPerson& learned() const override { return script_.learned; }
  void keep_model(bool keep) override { script_.keeps_model = keep; }
  const track::TrackResult& process(std::span<const Frame> views) override {
    const Frame& frame = views.front();
    script_.tracker_gate.pass();
    if (frame.sequence == script_.tracker_throws_at) {
      throw std::runtime_error("scripted tracker fault");
    }
    result_.state = script_.state_of(frame.sequence);
    result_.has_mesh = result_.state == mesh::TrackingState::Tracking ||
                       (result_.state == mesh::TrackingState::Acquiring && script_.mesh_while_acquiring);
    result_.subject = script_.subject_of(frame.sequence);
    result_.values = script_.read_values;
    result_.value_confidence = script_.read_confidence;
    result_.landmarks_px.assign(result_.state == mesh::TrackingState::Searching ? 0 : 468,
                                Eigen::Vector2f(1, 2));
    script_.model->evaluate(result_.identity, result_.expression, result_.vertices_mm);
    return result_;
  }
  void reset_identity() override { ++script_.identity_resets; }
  void request_stop() override { script_.tracker_stopped = true; }

 private:
  Script& script_;
  track::TrackResult result_;
};

class ScriptedRefiner final : public refine::RefineStage {
 public:
  explicit ScriptedRefiner(Script& script) : script_(script) { ++script_.refiners_alive; }
  ~ScriptedRefiner() override { --script_.refiners_alive; }

  std::string device() const override { return "scripted GPU"; }
  void set_subject(const refine::SubjectSetup& subject) override {
    ++script_.subjects_set;
    script_.known_shapes.push_back(subject.known_shape);
    script_.known_skins.push_back(subject.skin_albedo.cols() > 0);
    vertex_count_ = static_cast<std::size_t>(subject.hierarchy->finest().vertex_count);
  }
  void restart() override { restarted_ = true; }
  refine::RefineOutcome refine(const refine::RefineInput& input, refine::RefineOutput& output) override {
    script_.refiner_gate.pass();
    if (std::exchange(restarted_, false)) {
      script_.restarted_before.push_back(input.image.sequence);
    }
    if (input.image.sequence >= script_.no_room_from) {
      throw Error(ErrorKind::NoDevice, "scripted: too large");
    }
    script_.time_limit_ms = input.time_limit_ms;
    const refine::RefineOutcome outcome = script_.outcome_of(input.image.sequence);
    output.failure = outcome == refine::RefineOutcome::Refined ? "" : "scripted failure";
    output.displacements_mm.assign(vertex_count_, 0.125F);
    output.confidence.assign(vertex_count_, 0.5F);
    output.photometric_rms = 0.02F;
    output.given_up = script_.hurried ? "scripted hurry" : "";
    output.displacement_ms = 3;
    return outcome;
  }

 private:
  Script& script_;
  std::size_t vertex_count_ = 0;
  bool restarted_ = false;
};

}  // namespace

void Gate::set(bool open) {
  const std::lock_guard lock(mutex_);
  open_ = open;
  changed_.notify_all();
}

void Gate::pass() {
  std::unique_lock lock(mutex_);
  ++visitors_;
  changed_.notify_all();
  changed_.wait(lock, [&] { return open_; });
  --visitors_;
}

void Gate::wait_for_visitor() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return visitors_ > 0; });
}

Script::Script()
    : state_of([](std::uint64_t) { return mesh::TrackingState::Tracking; }),
      subject_of([](std::uint64_t) { return 1U; }),
      outcome_of([](std::uint64_t) { return refine::RefineOutcome::Refined; }),
      model(std::make_shared<const face::FaceModel>(synthetic_model(17))) {}

pipeline::ShadingParts Script::stages() {
  pipeline::ShadingParts stages;
  stages.pictures = pipeline::one_camera(std::make_unique<ScriptedCamera>(*this));
  stages.model = model;
  stages.coarse = std::make_unique<ScriptedTracker>(*this);
  if (has_refiner) {
    stages.open_refiner = [this] {
      ++opens;
      if (failing_opens > 0) {
        --failing_opens;
        throw Error(ErrorKind::NoDevice, "scripted: no device");
      }
      return std::make_unique<ScriptedRefiner>(*this);
    };
    stages.refiner = std::make_unique<ScriptedRefiner>(*this);
  }
  return stages;
}

void CollectingSink::deliver(std::shared_ptr<const mesh::MeshFrame> frame) {
  const std::lock_guard lock(mutex_);
  addresses.push_back(frame.get());
  if (passes_ && passes_(*frame)) {
    passed_ = true;
    arrived_.notify_all();
  }
  if (keep) {
    frames_.push_back(std::move(frame));
    arrived_.notify_all();
  }
}

std::vector<std::shared_ptr<const mesh::MeshFrame>> CollectingSink::frames() const {
  const std::lock_guard lock(mutex_);
  return frames_;
}

void CollectingSink::wait_for(const std::function<bool(const mesh::MeshFrame&)>& passes) {
  std::unique_lock lock(mutex_);
  passed_ = false;
  for (const auto& frame : frames_) {
    passed_ = passed_ || passes(*frame);
  }
  passes_ = passes;
  arrived_.wait(lock, [&] { return passed_; });
  passes_ = nullptr;
}

void CollectingSets::deliver(std::shared_ptr<const FrameSet> set) {
  const std::lock_guard lock(mutex_);
  sets_.push_back(std::move(set));
}

std::vector<std::shared_ptr<const FrameSet>> CollectingSets::sets() const {
  const std::lock_guard lock(mutex_);
  return sets_;
}

}  // namespace facet::test
