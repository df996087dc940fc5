#include "pipeline/booth_meshes.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <deque>
#include <span>
#include <utility>

#include "capture/frame_set.hpp"
#include "capture/rig_file.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "pipeline/bounded_queue.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/pipeline_board.hpp"
#include "pipeline/workers.hpp"

namespace facet::pipeline {
namespace {

using SetPointer = std::shared_ptr<const FrameSet>;

constexpr std::size_t kDepth = 0;  // workers
constexpr std::size_t kPerform = 1;

/// A gap of more slots ends a run.
constexpr std::uint64_t kMostGap = 2 * booth::kDepthReach;

/// So many periods without a blank slot that is whole, and slots with stripes wait no longer for one.
constexpr std::size_t kMostPeriods = 4;

/// Recorded slots: the person is looked for in so many of the first blank ones. They are held meanwhile.
constexpr std::ptrdiff_t kMostAhead = 24;

/// A slot so much calmer than the first is worth the way to it (PerformanceTracker::strain).
constexpr double kCalmer = 0.25;

/// The rig is looked at in one of so many blank slots.
constexpr std::uint64_t kCheckPeriod = 5;

struct RunSlot {
  SetPointer set;  ///< null: missing
  capture::SlotLight light = {capture::SlotLight::Kind::Stripes};
  bool wanted = false;
};

struct Run {
  std::uint64_t first_slot = 0;
  std::vector<RunSlot> slots;   ///< consecutive
  std::vector<SetPointer> lit;  ///< lit by known lights, before its last blank slot; no run had them
  Clock::time_point complete;   ///< when its last slot came

  std::size_t wanted() const {
    return static_cast<std::size_t>(
        std::count_if(slots.begin(), slots.end(), [](const RunSlot& slot) { return slot.wanted; }));
  }
};

/// A slot with its depth.
struct Seen {
  SetPointer given;                     ///< as it was delivered
  SetPointer set;                       ///< in the rig's order
  std::vector<capture::DepthMap> maps;  ///< [pairs]
  bool blank = true;
  std::vector<SetPointer> lit;  ///< blank: the slots before it that known lights lit, in the rig's order
  std::string wrong;
  std::string rough;  ///< why its depth is not as good as another's; empty where it is
  float depth_ms = 0;
  Clock::time_point complete;
};

/// Why the depth of a blank slot of a run is rougher than others', for people: patterns lit one side of it
/// alone, as where a recording begins or ends, or where slots were lost. Else empty.
std::string why_rough(std::span<const RunSlot> slots, std::size_t at) {
  const auto is_there = [](const RunSlot& slot) { return slot.set != nullptr; };
  const auto blank = slots.begin() + static_cast<std::ptrdiff_t>(at);
  const std::size_t before = std::min(at, booth::kDepthReach);
  const std::size_t after = std::min(slots.size() - at - 1, booth::kDepthReach);
  if (slots[at].light.kind != capture::SlotLight::Kind::Blank) {
    return {};
  }
  if (std::none_of(blank - static_cast<std::ptrdiff_t>(before), blank, is_there)) {
    return "no slot before this one was recorded: its depth is rougher than the next ones'";
  }
  if (std::none_of(blank + 1, blank + 1 + static_cast<std::ptrdiff_t>(after), is_there)) {
    return "no slot after this one was recorded: its depth is rougher than the last ones'";
  }
  return {};
}

/// From the first slot that gets a mesh by a run to the last.
std::size_t reach_of_run(const BoothParts& stages) {
  const auto blanks = static_cast<std::size_t>(stages.blanks_per_run);
  return stages.every_slot ? blanks * stages.program.size() - 1 : (blanks - 1) * stages.program.size();
}

}  // namespace

void check(const BoothConfig& config) {
  if (config.rig_file.empty()) {
    throw Error(ErrorKind::Usage,
                "rig.file is missing: name the file that `facet calibrate` wrote (docs/booth.md)");
  }
  if (!capture::makes_meshes(config.program)) {
    throw Error(ErrorKind::Usage,
                "trigger.patterns must have slots with projector lines (for depth) and blank ones, [] (for "
                "texture), such as [[\"stripes.a\"], [\"stripes.b\"], []]");
  }
  if (const std::string why = booth::why_no_depth(config.program); !why.empty()) {
    throw Error(ErrorKind::Usage, why);
  }
  if (config.gpu_device == "none") {
    throw Error(ErrorKind::Usage,
                "a booth's depth maps need a Vulkan device: set gpu.device to \"auto\" (lavapipe will do, "
                "slowly)");
  }
}

BoothParts open_booth(const BoothConfig& config, int blanks_per_run) {
  check(config);
  BoothParts stages;
  stages.rig = std::make_shared<const capture::Rig>(capture::read_rig(config.rig_file));
  for (const capture::SlotLight& slot : config.program) {
    for (const std::string& name : slot.lights) {
      if (!capture::has_light(*stages.rig, name)) {
        throw Error(ErrorKind::Usage,
                    fmt::format("{}: there is no [[light]] or [[projector]] '{}', which slots are lit by "
                                "(trigger.light): add it with its place",
                                config.rig_file.string(), name));
      }
    }
  }
  stages.program = config.program;
  stages.program_rules = config.program_rules;
  stages.lights = config.lights;
  stages.every_slot = config.every_slot;
  stages.blanks_per_run = blanks_per_run;
  const auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config.model_file));
  std::optional<booth::FacePoints> points;
  if (!config.points_file.empty()) {
    points = booth::read_face_points(config.points_file);
  }
  auto shading =
      config.shading ? std::make_unique<booth::BoothShading>(config.gpu_device, *stages.rig) : nullptr;
  stages.tracker = std::make_unique<booth::PerformanceTracker>(
      model, config.landmark_nets, stages.rig, config.skin, std::move(points), std::move(shading));
  const std::size_t most_slots = reach_of_run(stages) + 1 + 2 * booth::kDepthReach;
  using Starts = booth::BoothDepth::Starts;
  stages.depth = std::make_unique<booth::BoothDepth>(
      config.gpu_device, stages.rig, config.depths, static_cast<int>(most_slots),
      blanks_per_run == 1 ? Starts::KeptOfTheRunBefore : Starts::Found);
  stages.check = std::make_unique<booth::RigCheck>(stages.rig, stages.depth->depths());
  return stages;
}

struct BoothMeshes::Impl {
  Impl(BoothParts given, WhenBusy busy, std::vector<MeshSink*> given_sinks, DepthTaker taker)
      : stages(std::move(given)),
        when_busy(busy),
        sinks(std::move(given_sinks)),
        take_depth(std::move(taker)),
        runs(1),
        seen(1) {
    note_device();
    camera_names = std::make_shared<std::vector<std::string>>();
    for (const capture::RigCamera& camera : stages.rig->cameras) {
      camera_names->push_back(camera.name);
    }
  }

  // Set before the threads start.
  BoothParts stages;
  WhenBusy when_busy;
  std::vector<MeshSink*> sinks;
  DepthTaker take_depth;
  std::shared_ptr<std::vector<std::string>> camera_names;  ///< of the rig

  // Shared by the threads.
  Messages messages;
  Workers workers{{"facet-depth", "facet-perform"},
                  [this](ErrorKind kind, const std::string& what) { fail(kind, what); }};
  std::atomic<bool> stopping{false};
  std::atomic<bool> wants_new_identity{false};
  BoundedQueue<Run> runs;
  BoundedQueue<Seen> seen;
  PipelineBoard board;

  // The delivering thread only.
  std::deque<RunSlot> window;    ///< the last slots, consecutive
  std::uint64_t first_slot = 0;  ///< of the window
  std::size_t wanted = 0;        ///< slots in it that get a mesh and that no run has taken
  std::deque<SetPointer> lit;    ///< lit by known lights, that no run has taken

  // facet-depth only.
  std::vector<std::size_t> rig_from_set;  ///< [rig cameras] the frame in a set
  std::shared_ptr<const std::vector<std::string>> names_before;

  // facet-perform only.
  FramePool pool;
  std::vector<Seen> ahead;         ///< the first ones of a recording, until enough are there
  std::deque<Seen> waiting;        ///< not blank, for the blank slot after them
  std::int64_t last_blank_ns = 0;  ///< time of the last blank slot
  std::uint32_t subjects = 0;
  std::uint64_t subject_id = 0;
  std::uint64_t unchecked = 0;  ///< slots since the rig was looked at
  std::string rig_wrong;        ///< RigCheck::look
  mesh::TrackingState state = mesh::TrackingState::Searching;

  void fail(ErrorKind kind, const std::string& what);
  void note_device() {
    board.change([this](PipelineStatus& shown) { shown.device = stages.depth->device(); });
  }
  capture::SlotLight light_of(std::uint64_t slot, const SetPointer& set) const;
  void add(std::uint64_t slot, SetPointer set);
  void hand_on(bool at_end);
  void find_depth();
  void find_depth(Run& run);
  SetPointer in_rig_order(const FrameSet& set);
  void check_size(const FrameSet& set) const;
  void perform();
  void perform_ahead();
  void begin_with_calmest();
  void perform(Seen& item);
  void perform_waiting(std::int64_t blank_ns);
  std::vector<booth::LitSlot> lit_before(const Seen& item) const;
  std::shared_ptr<mesh::MeshFrame> begin_frame(const Seen& item);
  void hand_out(const Seen& item, const std::shared_ptr<mesh::MeshFrame>& frame);
  void check_rig(const FrameSet& set, mesh::MeshFrame& frame);
  void tell(const mesh::MeshFrame& frame);
};

void BoothMeshes::Impl::fail(ErrorKind kind, const std::string& what) {
  board.fail(kind, what);
  stopping = true;
  runs.close();
  seen.close();
}

/// What a slot says of its light, or the program.
capture::SlotLight BoothMeshes::Impl::light_of(std::uint64_t slot, const SetPointer& set) const {
  const bool says = set != nullptr && !stages.program_rules;
  const auto own = says ? capture::read_slot_light(set->light) : std::nullopt;
  return own.value_or(capture::light_of_slot(stages.program, slot));
}

void BoothMeshes::Impl::add(std::uint64_t slot, SetPointer set) {
  using Kind = capture::SlotLight::Kind;
  RunSlot& one = window.emplace_back();
  one.light = light_of(slot, set);
  if (one.light.kind == Kind::Lit && set != nullptr && stages.lights) {
    lit.push_back(set);
    if (lit.size() > 2 * stages.program.size() * static_cast<std::size_t>(stages.blanks_per_run)) {
      lit.pop_front();
    }
  }
  const auto has_picture = [](const Frame& picture) { return !picture.empty(); };
  one.wanted = (one.light.kind == Kind::Blank || stages.every_slot) && set != nullptr &&
               std::any_of(set->frames.begin(), set->frames.end(), has_picture);
  one.set = std::move(set);
  wanted += one.wanted ? 1 : 0;
}

/// Makes a run of the window once enough slots that are wanted have all the slots around them that they ever
/// will.
void BoothMeshes::Impl::hand_on(bool at_end) {
  // From the first slot that waits to the last that a run may have: where one between them is missing, the
  // run has fewer.
  const std::size_t reach = reach_of_run(stages);
  const auto waits = [](const RunSlot& slot) { return slot.wanted; };
  const auto first =
      static_cast<std::size_t>(std::find_if(window.begin(), window.end(), waits) - window.begin());
  std::size_t ready = 0;
  std::size_t last = first;  // the last ready one
  for (std::size_t i = first; i < window.size() && i <= first + reach; ++i) {
    if (window[i].wanted && (at_end || i + booth::kDepthReach < window.size())) {
      ++ready;
      last = i;
    }
  }
  const bool whole = first + reach + booth::kDepthReach < window.size();
  if (ready > 0 && (at_end || whole)) {
    const std::size_t begin = first - std::min(first, booth::kDepthReach);
    const std::size_t end = std::min(window.size(), last + booth::kDepthReach + 1);
    Run run;
    run.complete = Clock::now();
    run.first_slot = first_slot + begin;
    for (std::size_t i = begin; i < end; ++i) {
      run.slots.push_back(window[i]);
      run.slots.back().wanted = window[i].wanted && i <= last;
      window[i].wanted = window[i].wanted && i > last;
    }
    wanted -= ready;
    std::size_t last_blank = last;
    while (last_blank > begin && window[last_blank].light.kind != capture::SlotLight::Kind::Blank) {
      --last_blank;
    }
    while (!lit.empty() && lit.front()->slot < first_slot + last_blank) {
      run.lit.push_back(std::move(lit.front()));
      lit.pop_front();
    }
    if (when_busy == WhenBusy::Wait) {
      runs.push(std::move(run));
    } else {
      Run dropped;
      runs.push_newest(std::move(run), dropped);
      board.change([&](PipelineStatus& shown) { shown.dropped += dropped.wanted(); });
    }
  }
  // A slot to come, or one that waits, looks back this far.
  std::size_t keep = booth::kDepthReach;
  for (std::size_t i = 0; i < window.size() && wanted > 0; ++i) {
    if (window[i].wanted) {
      keep = window.size() - i + booth::kDepthReach;
      break;
    }
  }
  while (window.size() > keep) {
    window.pop_front();
    ++first_slot;
  }
}

void BoothMeshes::Impl::find_depth() {
  Run run;
  const auto beat = [this] { workers.beat(kDepth); };
  while (runs.pop(run, beat)) {
    beat();
    if (!stopping) {
      find_depth(run);
    }
    run = {};
  }
  seen.close();
}

/// The set's frames in the rig's order. Throws Error(Usage) where a camera of the rig is not in the set.
SetPointer BoothMeshes::Impl::in_rig_order(const FrameSet& set) {
  if (set.camera_names == nullptr) {
    throw Error(ErrorKind::UnreadableInput, "the frame sets do not say which camera made which picture");
  }
  if (set.camera_names != names_before && (names_before == nullptr || *set.camera_names != *names_before)) {
    rig_from_set.clear();
    for (const std::string& name : *camera_names) {
      const auto at = std::find(set.camera_names->begin(), set.camera_names->end(), name);
      if (at == set.camera_names->end()) {
        throw Error(
            ErrorKind::Usage,
            fmt::format("the rig's camera '{}' is not among those of the frame sets ({}): is it another "
                        "rig's file?",
                        name, fmt::join(*set.camera_names, ", ")));
      }
      rig_from_set.push_back(static_cast<std::size_t>(at - set.camera_names->begin()));
    }
  }
  names_before = set.camera_names;
  auto ordered = std::make_shared<FrameSet>();
  ordered->slot = set.slot;
  ordered->trigger_ns = set.trigger_ns;
  ordered->media_time_ns = set.media_time_ns;
  ordered->skew_ns = set.skew_ns;
  ordered->light = set.light;
  ordered->camera_names = camera_names;
  for (std::size_t i = 0; i < rig_from_set.size(); ++i) {
    ordered->frames.push_back(set.frames.at(rig_from_set[i]));
    ordered->missing |= ordered->frames.back().empty() ? std::uint64_t{1} << i : 0;
  }
  check_size(*ordered);
  return ordered;
}

void BoothMeshes::Impl::check_size(const FrameSet& set) const {
  for (std::size_t i = 0; i < set.frames.size(); ++i) {
    const Frame& frame = set.frames[i];
    const capture::RigCamera& camera = stages.rig->cameras[i];
    if (!frame.empty() &&
        (frame.width_px != camera.lens.width_px || frame.height_px != camera.lens.height_px)) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("camera '{}' gives pictures of {} x {} px, the rig file has it calibrated at {} x {}: "
                      "set the size it was calibrated at, or calibrate again",
                      camera.name, frame.width_px, frame.height_px, camera.lens.width_px,
                      camera.lens.height_px));
    }
  }
}

void BoothMeshes::Impl::find_depth(Run& run) {
  std::vector<SetPointer> sets;
  std::vector<booth::DepthSlot> slots;
  for (const RunSlot& slot : run.slots) {
    sets.push_back(slot.set != nullptr ? in_rig_order(*slot.set) : nullptr);
    booth::DepthSlot& one = slots.emplace_back();
    one.set = sets.back().get();
    one.has_pattern = slot.light.has_pattern();
    one.wanted = slot.wanted;
    const bool blank = slot.light.kind == capture::SlotLight::Kind::Blank;
    if (blank || slot.light.kind == capture::SlotLight::Kind::Fringes) {
      one.fringes = {slot.light.quarters / 4.0, blank};
    }
  }
  const Clock::time_point begun = Clock::now();
  std::vector<std::vector<capture::DepthMap>> maps;
  const std::string wrong = stages.depth->find(run.first_slot, slots, maps, [this] { workers.beat(kDepth); });
  const float depth_ms = ms_since(begun);
  std::size_t at = 0;
  auto next_lit = run.lit.begin();
  for (std::size_t i = 0; i < run.slots.size(); ++i) {
    if (run.slots[i].wanted) {
      Seen item;
      item.given = run.slots[i].set;
      item.set = sets[i];
      item.depth_ms = depth_ms / static_cast<float>(maps.size());
      item.maps = std::move(maps[at++]);
      capture::weigh_by_own_noise(item.maps);
      item.blank = run.slots[i].light.kind == capture::SlotLight::Kind::Blank;
      while (item.blank && next_lit != run.lit.end() && (*next_lit)->slot < item.given->slot) {
        item.lit.push_back(in_rig_order(**next_lit++));
      }
      item.wrong = wrong;
      item.rough = why_rough(run.slots, i);
      item.complete = run.complete;
      seen.push(std::move(item), [this] { workers.beat(kDepth); });
    }
  }
  note_device();
}

void BoothMeshes::Impl::perform() {
  Seen item;
  bool looks_ahead = when_busy == WhenBusy::Wait;
  const auto beat = [this] { workers.beat(kPerform); };
  const auto is_blank = [](const Seen& one) { return one.blank; };
  while (seen.pop(item, beat)) {
    beat();
    if (stopping || stages.tracker == nullptr) {
      // let go
    } else if (!looks_ahead) {
      perform(item);
    } else {
      ahead.push_back(std::move(item));
      looks_ahead = std::count_if(ahead.begin(), ahead.end(), is_blank) < kMostAhead;
      if (!looks_ahead) {
        perform_ahead();
      }
    }
    item = {};
  }
  perform_ahead();
  if (!stopping) {
    perform_waiting(last_blank_ns);
  }
}

void BoothMeshes::Impl::perform_ahead() {
  begin_with_calmest();
  for (Seen& item : ahead) {
    workers.beat(kPerform);
    if (!stopping) {
      perform(item);
    }
    item = {};
  }
  ahead.clear();
}

/// A recording need not begin with a face at rest: what the first mesh takes for the person is better known
/// from the calmest of the first slots. From there the mesh is followed back to the first slot, and all are
/// gone through from that on.
void BoothMeshes::Impl::begin_with_calmest() {
  std::vector<const Seen*> blanks;
  std::vector<double> strains;
  for (const Seen& item : ahead) {
    workers.beat(kPerform);
    const std::optional<double> strain =
        stopping || !item.blank ? std::nullopt : stages.tracker->strain(*item.set, item.maps);
    if (strain) {
      blanks.push_back(&item);
      strains.push_back(*strain);
    }
  }
  const auto calmest = std::min_element(strains.begin(), strains.end());
  if (strains.empty() || *calmest > strains.front() - kCalmer) {
    return;
  }
  for (auto at = calmest - strains.begin(); at >= 0 && !stopping; --at) {
    workers.beat(kPerform);
    const Seen& item = *blanks[static_cast<std::size_t>(at)];
    mesh::MeshFrame unseen;
    stages.tracker->process(*item.set, item.maps, unseen);
  }
  messages.info(fmt::format("slot {}: the calmest face of the first {}; the person is taken from it",
                            blanks[static_cast<std::size_t>(calmest - strains.begin())]->set->slot,
                            strains.size()));
}

void BoothMeshes::Impl::perform(Seen& item) {
  if (wants_new_identity.exchange(false)) {
    stages.tracker->reset();
  }
  if (!item.blank) {
    waiting.push_back(std::move(item));
    if (waiting.size() > kMostPeriods * stages.program.size()) {
      perform_waiting(last_blank_ns);
    }
    return;
  }
  const std::shared_ptr<mesh::MeshFrame> frame = begin_frame(item);
  stages.tracker->process(*item.set, item.maps, *frame, lit_before(item));
  check_rig(*item.set, *frame);
  perform_waiting(item.set->trigger_ns);
  last_blank_ns = item.set->trigger_ns;
  tell(*frame);
  hand_out(item, frame);
}

/// Those of its lit slots that lie between the last blank slot and it.
std::vector<booth::LitSlot> BoothMeshes::Impl::lit_before(const Seen& item) const {
  std::vector<booth::LitSlot> out;
  for (const SetPointer& set : item.lit) {
    const auto after = static_cast<double>(set->trigger_ns - last_blank_ns);
    const double fraction = after / static_cast<double>(item.set->trigger_ns - last_blank_ns);
    if (last_blank_ns != 0 && fraction > 0 && fraction < 1) {
      out.push_back({set.get(), fraction, light_of(set->slot, set).lights});
    }
  }
  return out;
}

/// The slots that are not blank between the last blank slot and that of blank_ns; the same: no blank slot has
/// come after them.
void BoothMeshes::Impl::perform_waiting(std::int64_t blank_ns) {
  for (Seen& item : waiting) {
    workers.beat(kPerform);
    const std::shared_ptr<mesh::MeshFrame> frame = begin_frame(item);
    const auto after = static_cast<double>(item.set->trigger_ns - last_blank_ns);
    stages.tracker->process_between(after / static_cast<double>(blank_ns - last_blank_ns), item.maps, *frame);
    hand_out(item, frame);
  }
  waiting.clear();
}

std::shared_ptr<mesh::MeshFrame> BoothMeshes::Impl::begin_frame(const Seen& item) {
  std::shared_ptr<mesh::MeshFrame> frame = pool.take();
  frame->sequence = item.set->slot;
  frame->timestamp_ns = item.set->trigger_ns;
  frame->media_time_ns = item.set->media_time_ns;
  frame->images = item.set;
  const std::string missing = capture::missing_pictures(*item.given);
  frame->degraded_reason = !item.wrong.empty() ? item.wrong : !missing.empty() ? missing : item.rough;
  frame->degraded = !frame->degraded_reason.empty();
  frame->stage_ms.depth_ms = item.depth_ms;
  if (take_depth && item.wrong.empty()) {
    take_depth(frame->sequence, item.maps);
  }
  return frame;
}

void BoothMeshes::Impl::hand_out(const Seen& item, const std::shared_ptr<mesh::MeshFrame>& frame) {
  frame->stage_ms.latency_ms = ms_since(item.complete);
  for (MeshSink* sink : sinks) {
    sink->complete(*frame);
  }
  for (MeshSink* sink : sinks) {
    sink->deliver(frame);
  }
  board.change([&](PipelineStatus& shown) {
    shown.subjects = subjects;
    if (frame->subject != nullptr) {
      shown.finest_vertices = frame->subject->hierarchy->finest().vertex_count;
      shown.levels = static_cast<int>(frame->subject->hierarchy->levels.size());
    }
  });
  board.count(*frame, frame->state == mesh::TrackingState::Tracking || !frame->landmarks_px.empty());
}

/// Whether the cameras stand as they were calibrated: now and then, and while there is no mesh.
void BoothMeshes::Impl::check_rig(const FrameSet& set, mesh::MeshFrame& frame) {
  if (unchecked++ % kCheckPeriod == 0 || frame.state != mesh::TrackingState::Tracking) {
    const std::string wrong = stages.check->look(set);
    if (wrong != rig_wrong && !wrong.empty()) {
      messages.warning(wrong);
    } else if (wrong != rig_wrong) {
      messages.info("the cameras stand as they were calibrated again");
    }
    rig_wrong = wrong;
    board.change([this](PipelineStatus& shown) { shown.pairs = stages.check->pairs(); });
  }
  if (!rig_wrong.empty()) {
    frame.degraded = true;
    frame.degraded_reason += (frame.degraded_reason.empty() ? "" : "; ") + rig_wrong;
  }
}

/// The log is told where the state changes.
void BoothMeshes::Impl::tell(const mesh::MeshFrame& frame) {
  if (frame.subject != nullptr && frame.subject->id != subject_id) {
    subject_id = frame.subject->id;
    ++subjects;
    messages.info(fmt::format("slot {}: a face is followed, {} vertices", frame.sequence,
                              frame.subject->hierarchy->finest().vertex_count));
  } else if (frame.state != state && frame.state != mesh::TrackingState::Tracking) {
    messages.warning(fmt::format("slot {}: {}", frame.sequence, frame.degraded_reason));
  }
  state = frame.state;
}

BoothMeshes::BoothMeshes(BoothParts stages, WhenBusy when_busy, std::vector<MeshSink*> sinks,
                         DepthTaker take_depth)
    : impl_(std::make_unique<Impl>(std::move(stages), when_busy, std::move(sinks), std::move(take_depth))) {}

BoothMeshes::~BoothMeshes() {
  stop();
}

void BoothMeshes::start() {
  Impl& impl = *impl_;
  impl.workers.begin({{kPerform, [&impl] { impl.perform(); }}, {kDepth, [&impl] { impl.find_depth(); }}});
}

void BoothMeshes::deliver(SetPointer set) {
  Impl& impl = *impl_;
  const std::uint64_t slot = set->slot;
  std::uint64_t next = impl.first_slot + impl.window.size();
  if (!impl.window.empty() && (slot < next || slot > next + kMostGap)) {
    while (impl.wanted > 0) {
      impl.hand_on(true);
    }
    impl.window.clear();
    impl.lit.clear();
  }
  if (impl.window.empty()) {
    next = impl.first_slot = slot;
  }
  for (; next < slot; ++next) {
    impl.add(next, nullptr);
  }
  impl.add(slot, std::move(set));
  impl.hand_on(false);
}

void BoothMeshes::finish() {
  while (impl_->wanted > 0) {
    impl_->hand_on(true);
  }
  impl_->runs.close();
}

void BoothMeshes::request_stop() {
  impl_->stopping = true;
  impl_->runs.close();
  impl_->seen.close();
}

void BoothMeshes::stop() {
  request_stop();
  impl_->workers.join();
}

bool BoothMeshes::finished() const {
  return impl_->workers.finished();
}

PipelineStatus BoothMeshes::status() const {
  PipelineStatus status = impl_->board.status();
  status.queued_captured = impl_->runs.size();
  status.queued_tracked = impl_->seen.size();
  return status;
}

std::optional<Progress::Silence> BoothMeshes::longest_silence() const {
  return impl_->workers.progress().longest_silence();
}

void BoothMeshes::reset_identity() {
  impl_->wants_new_identity = true;
}

std::vector<Messages::Message> BoothMeshes::take_messages() {
  std::vector<Messages::Message> all = impl_->messages.take();
  if (impl_->stages.tracker != nullptr) {
    for (Messages::Message& message : impl_->stages.tracker->take_messages()) {
      all.push_back(std::move(message));
    }
  }
  return all;
}

}  // namespace facet::pipeline
