#include "pipeline/frames.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <exception>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>

#include "camera/simulated_devices.hpp"
#include "capture/frame_set_assembler.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/append_file.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/pipeline_board.hpp"
#include "pipeline/workers.hpp"
#include "take/reader.hpp"
#include "trigger/edge_log.hpp"
#include "trigger/program.hpp"
#include "trigger/virtual_trigger.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;

/// How long a thread waits for a frame, an event or a set before it looks whether to stop.
constexpr std::chrono::milliseconds kPatience{50};
/// A camera that streams and is out of step for this long is restarted, then after twice as long ...
constexpr Clock::duration kOutOfStepPatience = 5s;
constexpr Clock::duration kLongestOutOfStepPatience = 60s;
constexpr auto kLookPeriod = 1s;
/// A trigger rests that has not fired for this long, or for one and a half slots where these are longer;
constexpr std::int64_t kTriggerRests_ns = 250'000'000;
/// its cameras are said to wait after this long, or three slots.
constexpr std::int64_t kTriggerStands_ns = 1'000'000'000;
constexpr auto kFirstTriggerPause = 1s;
constexpr auto kLongestTriggerPause = 10s;
/// Rates of free-running cameras count as the same within this.
constexpr double kRateTolerance = 0.01;

/// The workers, as Progress counts them; the cameras follow one another.
constexpr std::size_t kSets = 0;  // workers
constexpr std::size_t kEdges = 1;
constexpr std::size_t kFirstCamera = 2;

std::vector<std::string> worker_names(std::size_t cameras) {
  std::vector<std::string> names = {"facet-sets", "facet-edges"};
  for (std::size_t camera = 0; camera < cameras; ++camera) {
    names.push_back(fmt::format("facet-cam-{}", camera));
  }
  return names;
}

std::int64_t period_ns(double rate_hz) {
  return std::llround(1e9 / rate_hz);
}

[[noreturn]] void refuse(const std::string& what) {
  throw Error(ErrorKind::Usage, "cameras: " + what);
}

capture::CaptureConfig capture_config(const DevicesConfig& config, double free_rate_hz) {
  capture::CaptureConfig capture;
  for (const DeviceCamera& camera : config.cameras) {
    capture.cameras.push_back({camera.name, camera.latency_ns});
  }
  const bool triggered = config.trigger != TriggerKind::None;
  capture.synchronisation =
      triggered ? capture::Synchronisation::Triggered : capture::Synchronisation::FreeRunning;
  capture.period_ns = period_ns(triggered ? config.program.slots_per_second : free_rate_hz);
  capture.deadline_ns = config.deadline_ms > 0 ? std::int64_t{config.deadline_ms} * 1'000'000
                                               : std::clamp<std::int64_t>(100'000'000, 6 * capture.period_ns,
                                                                          32 * capture.period_ns);
  return capture;
}

/// Whole periods of a take of pictures; null where none is configured.
std::shared_ptr<const simulated::Footage> read_footage(const DevicesConfig& config) {
  if (config.footage.empty()) {
    return nullptr;
  }
  auto footage = std::make_shared<simulated::Footage>();
  footage->patterns = config.program.patterns;
  footage->slots_per_second = config.program.slots_per_second;
  take::TakeReader take(config.footage);
  const std::size_t period = footage->patterns.size();
  std::uint64_t first_slot = 0;
  for (std::int64_t i = 0; i < take.frame_count(); ++i) {
    const auto frame = take.frame(i);
    if (frame->images == nullptr || (footage->slots.empty() && frame->sequence % period != 0)) {
      continue;
    }
    if (footage->cameras.empty()) {
      footage->cameras = *frame->images->camera_names;
      first_slot = frame->sequence;
    }
    if (frame->sequence != first_slot + footage->slots.size()) {
      break;  // what comes after a gap would come too early
    }
    footage->add(*frame->images);
  }
  footage->slots.resize(footage->slots.size() / period * period);
  if (footage->slots.empty()) {
    refuse(fmt::format("'{}' holds no whole period of the trigger's patterns in pictures",
                       config.footage.string()));
  }
  return footage;
}

void check_camera(const DeviceCamera& camera, TriggerKind trigger) {
  const bool plain = std::all_of(camera.name.begin(), camera.name.end(),
                                 [](char c) { return c > ' ' && c <= '~' && c != '/'; });
  if (camera.name.empty() || camera.name.size() > 64 || !plain) {
    refuse(fmt::format("'{}' is no name of a camera: 1 to 64 visible characters without blank and slash",
                       camera.name));
  }
  if (camera.source.kind == "file" && trigger != TriggerKind::None) {
    refuse(
        fmt::format("camera '{}' is a file, which no trigger fires: use [trigger] kind = \"none\" with files",
                    camera.name));
  }
  if (camera.source.kind == camera::kSimulatedCamera.name && trigger == TriggerKind::Gpio) {
    refuse(fmt::format("camera '{}' is simulated and hangs on no GPIO line: use [trigger] kind = \"virtual\"",
                       camera.name));
  }
}

/// The rate of free-running cameras.
double common_rate_hz(const Devices& devices) {
  const double rate_hz = devices.cameras.front()->info().rate_hz;
  for (std::size_t i = 0; i < devices.cameras.size(); ++i) {
    const double other_hz = devices.cameras[i]->info().rate_hz;
    if (!(other_hz > 0) || std::abs(other_hz - rate_hz) > kRateTolerance * rate_hz) {
      refuse(fmt::format(
          "camera '{}' runs at {:.2f} Hz, camera '{}' at {:.2f} Hz: cameras without a trigger "
          "need one rate",
          devices.config.cameras[i].name, other_hz, devices.config.cameras.front().name, rate_hz));
    }
  }
  return rate_hz;
}

capture::CaptureConfig capture_config(const Devices& devices) {
  return capture_config(devices.config, devices.open_trigger ? 0 : common_rate_hz(devices));
}

/// Writes what the lines do, up to the most that a log holds.
class EdgeLogFile {
 public:
  EdgeLogFile(std::filesystem::path path, const TriggerProgram& program)
      : path_(std::move(path)), text_(trigger::to_text(trigger::EdgeLog{program.lines, {}})) {
    flush();
  }
  ~EdgeLogFile() { flush(); }
  EdgeLogFile(const EdgeLogFile&) = delete;
  EdgeLogFile& operator=(const EdgeLogFile&) = delete;

  /// What is to be told, once: the log can't be written, or is full.
  std::optional<std::string> add(const TriggerEvent& event) {
    if (path_.empty() || closed_) {
      return std::nullopt;
    }
    text_ += trigger::to_text(event);
    if (text_.size() >= kMostWaitingBytes) {
      flush();
    }
    if (failed_) {
      closed_ = true;
      return fmt::format("edge log '{}' can't be written: check folder and disk", path_.string());
    }
    if (++events_ == trigger::kMostLoggedEvents) {
      flush();
      file_ = {};
      closed_ = true;
      return fmt::format("edge log '{}' has {} events and is closed", path_.string(), events_);
    }
    return std::nullopt;
  }

  void flush() {
    if (path_.empty() || closed_ || failed_) {
      return;
    }
    try {
      if (!file_) {
        file_ = files::AppendFile::replace(path_);
      }
      file_.append(std::as_bytes(std::span(text_)));
      text_.clear();
    } catch (const std::exception&) {
      failed_ = true;
    }
  }

 private:
  static constexpr std::size_t kMostWaitingBytes = 8192;

  std::filesystem::path path_;
  files::AppendFile file_;
  std::string text_;  ///< not in the file yet
  std::size_t events_ = 0;
  bool failed_ = false;
  bool closed_ = false;
};

}  // namespace

capture::SlotProgram lights_of(const DevicesConfig& config) {
  if (!config.lights.empty()) {
    return config.lights;
  }
  using Kind = capture::SlotLight::Kind;
  capture::SlotProgram program;
  for (const LineMask active : config.program.patterns) {
    program.push_back({active != 0 ? Kind::Stripes : Kind::Blank});
  }
  return program;
}

void check(const DevicesConfig& config) {
  if (config.cameras.empty()) {
    refuse("there is no camera: add a section [[camera]]");
  }
  std::set<std::string> names;
  for (const DeviceCamera& camera : config.cameras) {
    check_camera(camera, config.trigger);
    if (!names.insert(camera.name).second) {
      refuse(fmt::format("two cameras are named '{}'", camera.name));
    }
  }
  if (config.trigger != TriggerKind::None) {
    trigger::check(config.program);
    if (!config.lights.empty() && config.lights.size() != config.program.patterns.size()) {
      refuse("trigger.light must have a word for each slot of trigger.patterns");
    }
    capture::FrameSetMatcher{capture_config(config, 0)};
  }
}

Devices open_devices(const DevicesConfig& config) {
  check(config);
  Devices devices;
  devices.config = config;
  const TriggerProgram& program = config.program;
  const bool triggered = config.trigger != TriggerKind::None;
  const auto room = std::make_shared<simulated::SimulatedDevices>(
      trigger::lines_of(program, LineRole::Camera), trigger::lines_of(program, LineRole::Projector),
      read_footage(config));
  for (const DeviceCamera& camera : config.cameras) {
    if (camera.source.kind == camera::kSimulatedCamera.name) {
      const camera::LiveConfig& size = camera.source.live;
      devices.cameras.push_back(camera::turn_pictures(
          room->camera({camera.name, size.width_px, size.height_px, size.rate_hz}, triggered),
          camera.source.turn));
    } else {
      camera::CameraConfig source = camera.source;
      source.paced = true;  // a file takes the place of a live camera here
      devices.cameras.push_back(camera::open_camera(source));
    }
  }
  switch (config.trigger) {
    case TriggerKind::None:
      break;
    case TriggerKind::Virtual:
      devices.open_trigger = [config, room] {
        trigger::VirtualTriggerOptions options;
        options.thread = config.gpio.thread;
        options.on_change = [room](LineMask active, std::int64_t time_ns) {
          room->on_change(active, time_ns);
        };
        return trigger::make_virtual_trigger(config.program, std::move(options));
      };
      break;
    case TriggerKind::Gpio:
      devices.open_trigger = [config] { return trigger::open_gpio_trigger(config.program, config.gpio); };
      break;
  }
  return devices;
}

struct FramesPipeline::Impl {
  Impl(Devices given, std::vector<FrameSetSink*> given_sinks)
      : devices(std::move(given)),
        sinks(std::move(given_sinks)),
        capture(capture_config(devices)),
        assembler(capture),
        workers(worker_names(devices.cameras.size()),
                [this](ErrorKind kind, const std::string& what) { fail(kind, what); }),
        watched(devices.cameras.size()),
        edge_log(devices.config.edge_log, devices.config.program) {
    if (devices.open_trigger) {
      for (const capture::SlotLight& light : lights_of(devices.config)) {
        words.push_back(capture::to_word(light));
      }
    }
  }

  // Set before the threads start.
  Devices devices;
  std::vector<FrameSetSink*> sinks;
  capture::CaptureConfig capture;

  // Shared by the threads.
  Messages messages;
  std::atomic<bool> stopping{false};
  std::atomic<std::size_t> cameras_at_work{0};
  std::atomic<std::int64_t> last_firing_ns{0};  ///< when it was told; at first, when the pipeline was started
  capture::FrameSetAssembler assembler;
  Workers workers;
  PipelineBoard board;
  mutable Mutex mutex;
  Condition stop_asked;                                      ///< for the pause between two attempts
  std::shared_ptr<Trigger> trigger FACET_GUARDED_BY(mutex);  ///< null while it can't be opened
  std::string trigger_reason FACET_GUARDED_BY(mutex);        ///< why
  std::uint64_t triggers_opened FACET_GUARDED_BY(mutex) = 0;
  std::optional<Error> source_failure FACET_GUARDED_BY(mutex);

  // facet-sets only.
  struct Watched {
    bool in_step = true;
    Clock::time_point since;  ///< when it was in step, or restarted
    Clock::duration patience = kOutOfStepPatience;
    std::atomic<bool> restart_wanted{false};  ///< shared with the camera's thread
    std::atomic<bool> ended{false};           ///< any thread: a recorded camera is at its end
  };
  std::vector<Watched> watched;
  Clock::time_point next_look;
  std::optional<std::int64_t> first_trigger_ns;
  std::vector<std::string> words;  ///< FrameSet::light of the program's slots; empty: nothing is triggered
  Pool<FrameSet> sets;

  // facet-edges only.
  EdgeLogFile edge_log;
  std::uint64_t next_slot = 0;

  void fail(ErrorKind kind, const std::string& what);

  void run_camera(std::size_t index);
  void watch_camera(std::size_t index, CameraState& state, std::string& reason);
  bool not_fired_for(std::int64_t time_ns) const;
  CameraStatus status_of(std::size_t index) const;
  void run_trigger();
  bool fire_until_failed(Trigger& lines);
  void take_event(const TriggerEvent& event);
  void show_trigger(std::shared_ptr<Trigger> now, const std::string& reason);
  bool pause(Clock::duration duration);
  void hand_out_sets();
  void deliver(std::shared_ptr<FrameSet> set);
  void look_after_steps();
};

void FramesPipeline::Impl::fail(ErrorKind kind, const std::string& what) {
  board.fail(kind, what);
  {
    const Lock lock(mutex);
    stopping = true;
  }
  stop_asked.notify_all();
  assembler.close();
}

/// False where there is no trigger.
bool FramesPipeline::Impl::not_fired_for(std::int64_t time_ns) const {
  return devices.open_trigger && Clock::now_ns() - last_firing_ns > time_ns;
}

/// What the camera says of itself, and whether it waits for the trigger, which it can't know.
CameraStatus FramesPipeline::Impl::status_of(std::size_t index) const {
  CameraStatus status = devices.cameras[index]->status();
  if (watched[index].ended) {
    status.state = CameraState::Ended;  // it is stopped, too
  }
  const bool well = status.state == CameraState::Opening || status.state == CameraState::Streaming;
  if (well && not_fired_for(std::max(kTriggerStands_ns, 3 * capture.period_ns))) {
    status.state = CameraState::Waiting;
    status.reason = "the trigger does not fire";
  }
  return status;
}

/// Tells the log and the assembler what became of a camera.
void FramesPipeline::Impl::watch_camera(std::size_t index, CameraState& state, std::string& reason) {
  const CameraStatus now = status_of(index);
  if (now.state == state && now.reason == reason) {
    return;
  }
  state = now.state;
  reason = now.reason;
  assembler.set_streaming(index, state == CameraState::Streaming || state == CameraState::Waiting);
  const std::string& name = devices.config.cameras[index].name;
  if (reason.empty()) {
    messages.info(fmt::format("camera {} {}", name, to_string(state)));
  } else {
    messages.warning(fmt::format("camera {} {}: {}", name, to_string(state), reason));
  }
}

void FramesPipeline::Impl::run_camera(std::size_t index) {
  Camera& camera = *devices.cameras[index];
  CameraState state = CameraState::Idle;
  std::string reason;
  assembler.set_streaming(index, false);
  camera.start();
  CaptureOutcome outcome = CaptureOutcome::Timeout;
  while (!stopping && outcome != CaptureOutcome::Failed && outcome != CaptureOutcome::EndOfStream) {
    Frame frame;
    workers.beat(kFirstCamera + index);
    camera.expect_frames(!not_fired_for(std::max(kTriggerRests_ns, capture.period_ns * 3 / 2)));
    outcome = camera.next(frame, kPatience);
    watch_camera(index, state, reason);
    if (outcome == CaptureOutcome::Delivered) {
      assembler.push(index, std::move(frame));
    }
    if (watched[index].restart_wanted.exchange(false)) {
      camera.restart("started anew: its pictures do not fit the trigger's slots");
    }
  }
  if (outcome == CaptureOutcome::Failed) {
    const Lock lock(mutex);
    source_failure.emplace(ErrorKind::UnreadableInput, camera.last_error());
  } else if (outcome == CaptureOutcome::EndOfStream && !camera.last_error().empty()) {
    messages.warning(camera.last_error());
    board.change([&](PipelineStatus& shown) { shown.reason = camera.last_error(); });
  }
  assembler.set_streaming(index, false);
  watched[index].ended = outcome == CaptureOutcome::EndOfStream && !stopping;
  camera.stop();
  --cameras_at_work;
}

void FramesPipeline::Impl::show_trigger(std::shared_ptr<Trigger> now, const std::string& reason) {
  const Lock lock(mutex);
  triggers_opened += now != nullptr ? 1 : 0;
  trigger = std::move(now);
  trigger_reason = reason;
}

/// False where a stop was asked for.
bool FramesPipeline::Impl::pause(Clock::duration duration) {
  const Clock::time_point end = Clock::now() + duration;
  const Lock lock(mutex);
  while (!stopping && Clock::now() < end) {
    workers.beat(kEdges);
    stop_asked.wait_until(mutex, Clock::wake(std::min(end, Clock::now() + kLookPeriod)));
  }
  return !stopping;
}

void FramesPipeline::Impl::take_event(const TriggerEvent& event) {
  next_slot = std::max(next_slot, event.slot + event.slot_count);
  if (event.kind == TriggerEvent::Kind::Fired) {
    last_firing_ns = Clock::now_ns();
    assembler.fired(event.slot, event.actual_ns);
  }
  if (const auto note = edge_log.add(event)) {
    messages.warning(*note);
  }
}

/// True where the lines failed, false where a stop was asked for.
bool FramesPipeline::Impl::fire_until_failed(Trigger& lines) {
  lines.start(next_slot);
  Clock::time_point next_flush = Clock::now() + kLookPeriod;
  bool failed = false;
  while (!stopping && !failed) {
    TriggerEvent event;
    workers.beat(kEdges);
    if (lines.next(event, kPatience)) {
      take_event(event);
    } else {
      failed = lines.status().state == TriggerState::Failing;
    }
    if (Clock::now() >= next_flush) {
      edge_log.flush();
      next_flush = Clock::now() + kLookPeriod;
    }
  }
  lines.request_stop();
  lines.stop();
  for (TriggerEvent event; lines.next(event, 0ms);) {
    take_event(event);
  }
  edge_log.flush();
  return failed;
}

void FramesPipeline::Impl::run_trigger() {
  Clock::duration wait = kFirstTriggerPause;
  while (!stopping) {
    std::string reason;
    try {
      const std::shared_ptr<Trigger> lines = devices.open_trigger();
      show_trigger(lines, "");
      messages.info("trigger running");
      const Clock::time_point begun = Clock::now();
      if (!fire_until_failed(*lines)) {
        return;
      }
      reason = lines->status().reason;
      wait = Clock::now() - begun > kLongestTriggerPause ? Clock::duration(kFirstTriggerPause) : wait;
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::Unavailable) {
        throw;
      }
      reason = error.what();
    }
    show_trigger(nullptr, reason);
    workers.beat(kEdges);
    messages.warning(fmt::format("trigger failing: {}", reason));
    if (!pause(wait)) {
      return;
    }
    wait = std::min<Clock::duration>(2 * wait, kLongestTriggerPause);
  }
}

void FramesPipeline::Impl::deliver(std::shared_ptr<FrameSet> set) {
  first_trigger_ns = first_trigger_ns.value_or(set->trigger_ns);
  set->media_time_ns = set->trigger_ns - *first_trigger_ns;
  set->light = words.empty() ? std::string() : words[set->slot % words.size()];
  const std::string missing = capture::missing_pictures(*set);
  mesh::StageTimes times;
  times.latency_ms = static_cast<float>(Clock::now_ns() - set->trigger_ns) * 1e-6F;
  const std::shared_ptr<const FrameSet> whole = std::move(set);
  for (FrameSetSink* sink : sinks) {
    sink->deliver(whole);
  }
  board.count(times, missing);
}

/// Tells the log of cameras that stream and come into no set, and has them restarted.
void FramesPipeline::Impl::look_after_steps() {
  const Clock::time_point now = Clock::now();
  if (now < next_look) {
    return;
  }
  next_look = now + kLookPeriod;
  const capture::CaptureStatistics statistics = assembler.statistics();
  for (std::size_t i = 0; i < watched.size(); ++i) {
    Watched& camera = watched[i];
    const std::string& name = devices.config.cameras[i].name;
    const bool streams = devices.cameras[i]->status().state == CameraState::Streaming;
    if (!streams || statistics.cameras[i].in_step) {
      if (!camera.in_step && streams) {
        messages.info(fmt::format("camera {} is in step again", name));
        camera.patience = kOutOfStepPatience;
        camera.in_step = true;
      }
      camera.since = now;
    } else if (now - camera.since >= camera.patience) {
      messages.warning(fmt::format(
          "camera {} is out of step with the trigger for {} s and is started anew; its pictures are left out",
          name, std::chrono::duration_cast<std::chrono::seconds>(camera.patience).count()));
      camera.in_step = false;
      camera.since = now;
      camera.patience = std::min(2 * camera.patience, kLongestOutOfStepPatience);
      camera.restart_wanted = true;
    }
  }
}

void FramesPipeline::Impl::hand_out_sets() {
  board.set_state(PipelineState::Running);
  const auto last_wait = std::chrono::nanoseconds(2 * capture.deadline_ns);
  Clock::time_point last_set = Clock::now();
  std::shared_ptr<FrameSet> set = sets.take();
  while (!stopping) {
    workers.beat(kSets);
    switch (assembler.next(*set, kPatience)) {
      case capture::FrameSetAssembler::Outcome::Delivered:
        last_set = Clock::now();
        deliver(std::exchange(set, sets.take()));
        break;
      case capture::FrameSetAssembler::Outcome::Timeout:
        if (cameras_at_work == 0 && Clock::now() - last_set > last_wait) {
          const Lock lock(mutex);
          if (source_failure) {
            throw Error(*source_failure);
          }
          board.set_state(PipelineState::Ended);
          return;
        }
        break;
      case capture::FrameSetAssembler::Outcome::Closed:
        break;
    }
    look_after_steps();
  }
  board.set_state(PipelineState::Stopped);
}

FramesPipeline::FramesPipeline(Devices devices, std::vector<FrameSetSink*> sinks)
    : impl_(std::make_unique<Impl>(std::move(devices), std::move(sinks))) {}

FramesPipeline::~FramesPipeline() {
  FramesPipeline::stop();
}

void FramesPipeline::start() {
  Impl& impl = *impl_;
  impl.board.set_state(PipelineState::Preparing);
  impl.cameras_at_work = impl.devices.cameras.size();
  impl.last_firing_ns = Clock::now_ns();
  std::vector<Workers::Work> works = {{kSets, [&impl] { impl.hand_out_sets(); }}};
  for (std::size_t i = 0; i < impl.devices.cameras.size(); ++i) {
    works.push_back({kFirstCamera + i, [&impl, i] { impl.run_camera(i); }});
  }
  if (impl.devices.open_trigger) {
    works.push_back({kEdges, [&impl] { impl.run_trigger(); }});
  }
  impl.workers.begin(works);
}

void FramesPipeline::request_stop() {
  {
    const Lock lock(impl_->mutex);
    impl_->stopping = true;
  }
  impl_->stop_asked.notify_all();
  impl_->assembler.close();
}

void FramesPipeline::stop() {
  request_stop();
  impl_->workers.join();
}

bool FramesPipeline::finished() const {
  return impl_->workers.finished();
}

PipelineStatus FramesPipeline::status() const {
  Impl& impl = *impl_;
  DevicesStatus rig;
  for (std::size_t i = 0; i < impl.devices.cameras.size(); ++i) {
    const Camera& camera = *impl.devices.cameras[i];
    rig.cameras.push_back({impl.devices.config.cameras[i].name, camera.info(), impl.status_of(i)});
  }
  rig.sets = impl.assembler.statistics();
  std::shared_ptr<Trigger> trigger;
  PipelineStatus status = impl.board.status();
  {
    const Lock lock(impl.mutex);
    trigger = impl.trigger;
    rig.triggers_opened = impl.triggers_opened;
    if (impl.devices.open_trigger) {
      rig.trigger.emplace();
      rig.trigger->state = impl.trigger_reason.empty() ? TriggerState::Idle : TriggerState::Failing;
      rig.trigger->reason = impl.trigger_reason;
    }
  }
  if (trigger != nullptr) {
    rig.trigger = trigger->status();
  }
  status.captured = rig.sets.slots;
  status.dropped = rig.sets.dropped;
  status.rig = std::move(rig);
  return status;
}

std::optional<Progress::Silence> FramesPipeline::longest_silence() const {
  return impl_->workers.progress().longest_silence();
}

void FramesPipeline::reset_identity() {
  throw Error(ErrorKind::Usage, "mode \"frames\" makes no meshes: there is no identity to estimate");
}

std::vector<Messages::Message> FramesPipeline::take_messages() {
  return impl_->messages.take();
}

}  // namespace facet::pipeline
