#include "studio/studio.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "animate/places.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "mesh/hierarchy.hpp"
#include "take/closing.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::studio {
namespace {

using nlohmann::json;

constexpr std::size_t kTimesKept = 256;
/// Keys closer than this are one, s.
constexpr double kSameTime_s = 1e-3;
constexpr double kDefaultRate_hz = 30;

/// The last durations, ms.
class Times {
 public:
  void add(Clock::duration took) {
    const float ms = std::chrono::duration<float, std::milli>(took).count();
    if (kept_.size() < kTimesKept) {
      kept_.push_back(ms);
    } else {
      kept_[next_] = ms;
      next_ = (next_ + 1) % kTimesKept;
    }
  }
  void clear() {
    kept_.clear();
    next_ = 0;
  }
  StudioTimes figures() const {
    if (kept_.empty()) {
      return {};
    }
    std::vector<float> sorted = kept_;
    std::sort(sorted.begin(), sorted.end());
    float sum = 0;
    for (const float one : sorted) {
      sum += one;
    }
    return {sum / static_cast<float>(sorted.size()), sorted[(sorted.size() - 1) * 95 / 100], sorted.back()};
  }

 private:
  std::vector<float> kept_;
  std::size_t next_ = 0;
};

/// A hue for each region, far from its neighbours' (golden angle), sRGB.
std::array<std::uint8_t, 3> colour_of(std::size_t region) {
  const double hue = std::fmod(0.02 + 0.381966 * static_cast<double>(region), 1.0);
  std::array<std::uint8_t, 3> out{};
  for (std::size_t channel = 0; channel < 3; ++channel) {
    const double shifted = std::fmod(hue + (channel == 0 ? 0.0 : channel == 1 ? 2.0 / 3 : 1.0 / 3), 1.0) * 6;
    const double part = std::clamp(std::abs(shifted - 3) - 1, 0.0, 1.0);
    out[channel] = static_cast<std::uint8_t>(std::lround(255 * (0.25 + 0.7 * part)));
  }
  return out;
}

std::filesystem::path keys_file(const std::filesystem::path& take) {
  return take.parent_path() / (take.stem().string() + ".keys.json");
}

bool all_finite(const mesh::MeshFrame& frame) {
  const Eigen::Map<const Eigen::VectorXf> displacements(
      frame.displacements_mm.data(), static_cast<Eigen::Index>(frame.displacements_mm.size()));
  const Eigen::Map<const Eigen::VectorXf> expression(frame.expression.data(),
                                                     static_cast<Eigen::Index>(frame.expression.size()));
  return frame.control_vertices_mm.allFinite() && displacements.allFinite() && expression.allFinite() &&
         frame.camera_from_head.matrix().allFinite();
}

}  // namespace

const char* to_string(Shown shown) {
  switch (shown) {
    case Shown::Pose:
      return "pose";
    case Shown::Take:
      return "take";
    case Shown::Keys:
      return "keys";
  }
  return "";
}

const char* to_string(StudioState state) {
  switch (state) {
    case StudioState::Closed:
      return "closed";
    case StudioState::Opening:
      return "opening";
    case StudioState::Ready:
      return "ready";
    case StudioState::Preparing:
      return "preparing";
    case StudioState::Playing:
      return "playing";
    case StudioState::Exporting:
      return "exporting";
  }
  return "";
}

struct Studio::Impl {
  /// What a controller wants next; the newest takes the place of the one before.
  struct Wish {
    enum class Kind : std::uint8_t { Pose, Play, Seek, Pause } kind = Kind::Pose;
    Shown shown = Shown::Pose;
    double time_s = 0;
    bool loop = false;
    Clock::time_point asked;  ///< when the command came
  };
  struct Opening {
    std::string take;  ///< "": close
    bool posing = false;
  };
  struct MeshEntry {
    std::int64_t index = 0;  ///< in the take
    double time_s = 0;       ///< from the first
    std::uint64_t sequence = 0;
  };
  /// What a controller may look at while the thread works: immutable, or safe for any thread.
  struct Faces {
    std::shared_ptr<const animate::TakeBasis> basis;
    std::shared_ptr<animate::FaceIk> ik;  ///< solve: the thread only; check: any
    mesh::Vertices rest_mm;
    std::vector<std::pair<std::string, std::int32_t>> places;
  };
  /// The open take; the thread only.
  struct Session {
    std::filesystem::path file;
    animate::FileState file_state;
    std::optional<take::TakeReader> reader;
    std::vector<MeshEntry> meshes;
    std::shared_ptr<const Faces> faces;  ///< null where it is open for replay alone
    animate::Pose pose;
    mesh::MeshFrame blank;
    std::string animated_keys;  ///< what `animation` was made of
    std::optional<animate::Animation> animation;
    double keys_rate_hz = kDefaultRate_hz;
    std::shared_ptr<const mesh::MeshFrame> last;  ///< on the stream
    std::uint64_t published = 0;
    // While playing.
    std::optional<Shown> playing;
    bool loop = false;
    double played_from_s = 0;
    Clock::time_point playing_since;
    Clock::time_point next_due;
    Clock::time_point repeat_due;
    Clock::time_point check_due;
  };

  Impl(std::filesystem::path takes, Show shower, std::function<void(bool)> hold, std::string name)
      : folder(std::move(takes)),
        show(std::move(shower)),
        hold_live(std::move(hold)),
        software(std::move(name)) {}

  const std::filesystem::path folder;
  const Show show;
  const std::function<void(bool)> hold_live;
  const std::string software;

  /// Never held while a face is made or a file is read or written.
  mutable Mutex mutex;
  Condition woken;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  std::optional<Opening> opening FACET_GUARDED_BY(mutex);
  std::optional<Wish> wish FACET_GUARDED_BY(mutex);
  std::filesystem::path export_to FACET_GUARDED_BY(mutex);  ///< empty: nothing is to be exported
  bool cancelled FACET_GUARDED_BY(mutex) = false;           ///< what is prepared or exported
  /// But targets are those that were solved, `wanted` those asked for.
  StudioStatus shown FACET_GUARDED_BY(mutex);
  Times latency FACET_GUARDED_BY(mutex);
  Times work FACET_GUARDED_BY(mutex);
  std::shared_ptr<const Faces> faces FACET_GUARDED_BY(mutex);
  std::vector<animate::ControlTarget> wanted FACET_GUARDED_BY(mutex);
  animate::IkOptions options FACET_GUARDED_BY(mutex);
  std::shared_ptr<const animate::InfluenceMaps> maps FACET_GUARDED_BY(mutex);  ///< of the last pose
  std::string keys FACET_GUARDED_BY(mutex);

  std::unique_ptr<Session> session;  ///< the thread only
  std::jthread thread;
  std::atomic<bool> ended{true};

  // Whoever asks.
  const Faces& ready_faces() const FACET_REQUIRES(mutex);
  animate::ControlTarget resolve(const animate::KeyControl& control) const FACET_REQUIRES(mutex);
  std::uint64_t ask_pose(std::vector<animate::ControlTarget> targets, const animate::IkOptions& how)
      FACET_REQUIRES(mutex);
  void ask(const Wish& what) FACET_REQUIRES(mutex);

  // The thread.
  void run();
  void work_until_stopped();
  bool work_once() FACET_REQUIRES(mutex);
  void guarded(const std::function<void()>& what);
  /// next_take: what is opened at once; empty: nothing.
  void close_session(const std::string& reason, const std::string& next_take = {});
  void open_session(const Opening& what);
  void do_wish(const Wish& what);
  void solve(const Wish& what);
  void begin_playing(const Wish& what);
  void play_on();
  void show_at(Shown what, double time_s);
  void prepare_keys();
  void export_keys(const std::filesystem::path& file);
  double duration_s(Shown what) const;
  mesh::MeshFrame animated(double time_s) const;
  std::size_t entry_at(double time_s) const;
  void publish(mesh::MeshFrame frame, std::optional<Clock::time_point> asked);
  void set_state(StudioState state);
  bool given_up();
  bool wanted_still(StudioState what);
};

// ---- whoever asks --------------------------------------------------------------------------------------

const Studio::Impl::Faces& Studio::Impl::ready_faces() const {
  if (faces != nullptr) {
    return *faces;
  }
  if (shown.state == StudioState::Opening || opening) {
    throw Error(ErrorKind::Unavailable, "the take is still being opened");
  }
  throw Error(ErrorKind::Usage,
              shown.take.empty()
                  ? "no take is open: studio.open opens one"
                  : fmt::format("take {} is open for replay alone: open it with pose true", shown.take));
}

animate::ControlTarget Studio::Impl::resolve(const animate::KeyControl& control) const {
  const Faces& now = ready_faces();
  const auto place = std::find_if(now.places.begin(), now.places.end(),
                                  [&](const auto& one) { return one.first == control.vertex; });
  animate::KeyControl numbered = control;
  if (place != now.places.end()) {
    numbered.vertex = std::to_string(place->second);
  }
  return animate::control_target(*now.basis, numbered, now.rest_mm);
}

void Studio::Impl::ask(const Wish& what) {
  if (wish && wish->kind == Wish::Kind::Pose) {
    ++shown.superseded;
  }
  wish = what;
  wish->asked = Clock::now();
  woken.notify_one();
}

std::uint64_t Studio::Impl::ask_pose(std::vector<animate::ControlTarget> targets,
                                     const animate::IkOptions& how) {
  ready_faces().ik->check(targets);
  wanted = std::move(targets);
  options = how;
  ++shown.events;
  ask({Wish::Kind::Pose, Shown::Pose, 0, false, {}});
  return shown.events;
}

// ---- the thread -----------------------------------------------------------------------------------------

void Studio::Impl::set_state(StudioState state) {
  const Lock lock(mutex);
  shown.state = state;
}

/// Somebody wants another take, or the end.
bool Studio::Impl::given_up() {
  const Lock lock(mutex);
  return stopping || opening.has_value();
}

/// What takes long shall go on.
bool Studio::Impl::wanted_still(StudioState what) {
  const Lock lock(mutex);
  // Places of the animation wait for it: a cursor that is dragged along must not begin it anew each time.
  const bool other = wish && (wish->kind == Wish::Kind::Pose || wish->kind == Wish::Kind::Pause ||
                              wish->shown != Shown::Keys);
  return !(stopping || opening || cancelled || (other && what == StudioState::Preparing));
}

void Studio::Impl::publish(mesh::MeshFrame frame, std::optional<Clock::time_point> asked) {
  if (!all_finite(frame)) {
    throw Error(ErrorKind::Internal, "a face is not finite: it is not shown");
  }
  const Clock::time_point now = Clock::now();
  frame.images = nullptr;
  frame.sequence = session->published++;
  frame.timestamp_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now.time_since_epoch()).count();
  frame.stage_ms = {};
  frame.stage_ms.latency_ms = asked ? std::chrono::duration<float, std::milli>(now - *asked).count() : 0.0F;
  session->last = std::make_shared<const mesh::MeshFrame>(std::move(frame));
  session->repeat_due = now + kRepeat;
  show(session->last);
}

void Studio::Impl::close_session(const std::string& reason, const std::string& next_take) {
  session.reset();
  hold_live(false);
  const Lock lock(mutex);
  shown = {};
  shown.reason = reason;
  if (!next_take.empty()) {
    shown.take = next_take;
    shown.state = StudioState::Opening;
  }
  latency.clear();
  work.clear();
  faces = nullptr;
  maps = nullptr;
  wanted.clear();
  keys.clear();
  wish.reset();
  export_to.clear();
}

void Studio::Impl::open_session(const Opening& what) {
  close_session("", what.take);
  if (what.take.empty()) {
    return;
  }
  auto made = std::make_unique<Session>();
  made->file = take::named_take(folder, what.take);
  const take::ClosedTake closed = take::close_take(made->file);
  if (!closed.info.closed) {
    throw Error(ErrorKind::Usage, fmt::format("take {}: {}", what.take, closed.left));
  }
  made->file_state = animate::state_of(made->file);
  made->reader.emplace(made->file);
  std::int64_t first_ns = 0;
  for (std::int64_t index = 0; index < made->reader->frame_count(); ++index) {
    const take::FrameEntry entry = made->reader->entry(index);
    if (!entry.has_mesh) {
      continue;
    }
    first_ns = made->meshes.empty() ? entry.media_time_ns : first_ns;
    const double time_s = static_cast<double>(entry.media_time_ns - first_ns) * 1e-9;
    const double least_s = made->meshes.empty() ? 0.0 : made->meshes.back().time_s;
    made->meshes.push_back({index, std::max(time_s, least_s), entry.sequence});
  }
  if (made->meshes.empty()) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("take {} has no mesh", what.take));
  }
  std::string stored_keys;
  std::string keys_fault;
  if (what.posing) {
    auto ready = std::make_shared<Faces>();
    ready->basis = animate::TakeBasis::open(made->file, {}, [&](std::int64_t done, std::int64_t total) {
      {
        const Lock lock(mutex);
        shown.done = done;
        shown.total = total;
      }
      return !given_up();
    });
    ready->ik = std::make_shared<animate::FaceIk>(ready->basis);
    ready->ik->set_view(ready->basis->sample().camera, ready->basis->sample().camera_from_head);
    ready->rest_mm = animate::resting_vertices(*ready->basis);
    ready->places = animate::places(*ready->basis);
    made->blank = animate::blank_frame(*ready->basis);
    made->faces = ready;
    std::error_code ignored;
    if (std::filesystem::exists(keys_file(made->file), ignored)) {
      try {
        stored_keys = files::read_text(keys_file(made->file), animate::kKeysLimits.most_bytes, "keys file");
        animate::parse_keys(stored_keys, keys_file(made->file).string());
      } catch (const Error& error) {
        stored_keys.clear();
        keys_fault = fmt::format("the take is open without its keys: {}; {}", error.what(),
                                 files::set_aside(keys_file(made->file)));
      }
    }
  }
  made->check_due = Clock::now() + kRepeat;
  session = std::move(made);
  hold_live(true);
  {
    const Lock lock(mutex);
    faces = session->faces;
    keys = std::move(stored_keys);
    options = {};
    shown.posing = faces != nullptr;
    shown.events = faces != nullptr ? 1 : 0;  // the resting face
    shown.places = faces != nullptr ? faces->places : decltype(faces->places)();
    shown.duration_s = session->meshes.back().time_s;
    shown.state = StudioState::Ready;
  }
  if (session->faces != nullptr) {
    solve({Wish::Kind::Pose, Shown::Pose, 0, false, Clock::now()});
  } else {
    show_at(Shown::Take, 0);
  }
  if (!keys_fault.empty()) {
    const Lock lock(mutex);
    shown.reason = std::move(keys_fault);
  }
}

void Studio::Impl::solve(const Wish& what) {
  std::vector<animate::ControlTarget> targets;
  animate::IkOptions how;
  {
    const Lock lock(mutex);
    targets = wanted;
    how = options;
  }
  const Clock::time_point began = Clock::now();
  animate::FaceIk& ik = *session->faces->ik;
  ik.set_options(how);
  const std::vector<animate::ControlOutcome>& outcomes = ik.solve(targets, session->pose);
  mesh::MeshFrame frame = session->blank;
  animate::blend(*session->faces->basis, session->pose, frame);
  const Clock::time_point made = Clock::now();
  publish(std::move(frame), what.asked);
  const auto& boundary = session->faces->basis->hierarchy().finest().one_rings.on_boundary;
  const Lock lock(mutex);
  work.add(made - began);
  latency.add(Clock::now() - what.asked);
  ++shown.solved;
  shown.shown = Shown::Pose;
  shown.state = StudioState::Ready;
  shown.time_s = 0;
  shown.reason.clear();
  shown.outcomes = outcomes;
  shown.on_boundary.clear();
  for (const animate::ControlTarget& target : targets) {
    shown.on_boundary.push_back(boundary[static_cast<std::size_t>(target.vertex)]);
  }
  shown.targets = std::move(targets);
  maps = session->pose.maps;
}

double Studio::Impl::duration_s(Shown what) const {
  return what == Shown::Keys ? session->animation->duration_s() : session->meshes.back().time_s;
}

mesh::MeshFrame Studio::Impl::animated(double time_s) const {
  animate::Pose pose;
  session->animation->pose(time_s, pose);
  mesh::MeshFrame frame = session->blank;
  animate::blend(*session->faces->basis, pose, frame);
  frame.media_time_ns = std::llround(time_s * 1e9);
  return frame;
}

/// The newest mesh of a time.
std::size_t Studio::Impl::entry_at(double time_s) const {
  const auto after = std::upper_bound(session->meshes.begin(), session->meshes.end(), time_s + 1e-6,
                                      [](double at_s, const MeshEntry& one) { return at_s < one.time_s; });
  return after == session->meshes.begin() ? 0 : static_cast<std::size_t>(after - session->meshes.begin()) - 1;
}

void Studio::Impl::show_at(Shown what, double time_s) {
  const double at_s = std::clamp(time_s, 0.0, duration_s(what));
  std::uint64_t sequence = 0;
  if (what == Shown::Keys) {
    publish(animated(at_s), {});
  } else {
    const MeshEntry& entry = session->meshes[entry_at(at_s)];
    sequence = entry.sequence;
    publish(*session->reader->frame(entry.index, take::Pictures::Described), {});
  }
  const Lock lock(mutex);
  shown.shown = what;
  shown.time_s = at_s;
  shown.frame = sequence;
}

void Studio::Impl::prepare_keys() {
  std::string text;
  {
    const Lock lock(mutex);
    text = keys;
  }
  if (session->animation && session->animated_keys == text) {
    return;
  }
  if (text.empty()) {
    throw Error(ErrorKind::Usage, "there are no keys yet");
  }
  set_state(StudioState::Preparing);
  const animate::KeyList list = animate::parse_keys(text, "keys");
  animate::AnimationReport report;
  session->animation = animate::Animation::of_keys(session->faces->basis, list, report,
                                                   [this] { return wanted_still(StudioState::Preparing); });
  session->animated_keys = std::move(text);
  session->keys_rate_hz = list.rate_hz > 0 ? list.rate_hz
                          : session->faces->basis->frame_period_s() > 0.001
                              ? 1.0 / session->faces->basis->frame_period_s()
                              : kDefaultRate_hz;
  const Lock lock(mutex);
  shown.warnings = std::move(report.warnings);
}

void Studio::Impl::begin_playing(const Wish& what) {
  session->playing = what.shown;
  session->loop = what.loop;
  session->played_from_s = what.time_s >= duration_s(what.shown) ? 0.0 : what.time_s;
  session->playing_since = session->next_due = Clock::now();
  set_state(StudioState::Playing);
}

void Studio::Impl::play_on() {
  const Shown what = *session->playing;
  const Clock::time_point now = Clock::now();
  const double end_s = duration_s(what);
  double time_s =
      session->played_from_s + std::chrono::duration<double>(now - session->playing_since).count();
  if (time_s >= end_s && session->loop && end_s > 0) {
    time_s = std::fmod(time_s, end_s);
    session->played_from_s = time_s;
    session->playing_since = now;
  }
  show_at(what, time_s);
  if (time_s >= end_s) {
    session->playing.reset();
    set_state(StudioState::Ready);
    return;
  }
  double step_s = 1.0 / session->keys_rate_hz;
  if (what == Shown::Take) {
    const std::size_t next = std::min(entry_at(time_s) + 1, session->meshes.size() - 1);
    step_s = std::max(1e-3, session->meshes[next].time_s - time_s);
  }
  session->next_due =
      now + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(step_s));
}

void Studio::Impl::do_wish(const Wish& what) {
  session->playing.reset();
  if (what.kind == Wish::Kind::Pose) {
    solve(what);
    return;
  }
  if (what.kind != Wish::Kind::Pause) {
    if (what.shown == Shown::Keys) {
      prepare_keys();
    }
    if (what.kind == Wish::Kind::Play) {
      begin_playing(what);
    } else {
      show_at(what.shown, what.time_s);
    }
  }
  const Lock lock(mutex);
  shown.reason.clear();
  shown.state = session->playing ? StudioState::Playing : StudioState::Ready;
}

void Studio::Impl::export_keys(const std::filesystem::path& file) {
  session->playing.reset();
  prepare_keys();
  const double rate_hz = session->keys_rate_hz;
  const auto count = std::max<std::int64_t>(1, std::llround(session->animation->duration_s() * rate_hz) + 1);
  {
    const Lock lock(mutex);
    shown.state = StudioState::Exporting;
    shown.done = 0;
    shown.total = count;
  }
  take::TakeRecorderConfig config;
  config.file = file;
  config.source = fmt::format("keys of {}", session->file.string());
  config.software = software;
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  bool broken_off = false;
  for (std::int64_t index = 0; index < count && !broken_off; ++index) {
    mesh::MeshFrame frame = animated(static_cast<double>(index) / rate_hz);
    frame.sequence = static_cast<std::uint64_t>(index);
    frame.timestamp_ns = frame.media_time_ns;
    recorder.record(std::make_shared<const mesh::MeshFrame>(std::move(frame)));
    broken_off = !wanted_still(StudioState::Exporting);
    const Lock lock(mutex);
    shown.done = index + 1;
  }
  const take::RecorderStatus status = recorder.stop();
  if (broken_off) {
    std::error_code ignored;
    std::filesystem::remove(file, ignored);
    throw Error(ErrorKind::Unavailable, "broken off");
  }
  if (status.state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", file.string(), status.reason));
  }
  const Lock lock(mutex);
  shown.state = StudioState::Ready;
  shown.reason.clear();
  shown.exported = file;
}

/// A take that is no longer what it was ends the session; whatever else fails stands in the status.
void Studio::Impl::guarded(const std::function<void()>& what) {
  try {
    what();
  } catch (const Error& error) {
    if (session == nullptr || error.kind() == ErrorKind::UnreadableInput) {
      close_session(given_up() ? "" : error.what());
      return;
    }
    session->playing.reset();
    const Lock lock(mutex);
    shown.state = StudioState::Ready;
    shown.reason = error.what();
  } catch (const std::exception& error) {
    close_session(error.what());
  }
}

/// One piece of work; false where there is none.
bool Studio::Impl::work_once() {
  const auto unlocked = [&](const std::function<void()>& what) FACET_REQUIRES(mutex) {
    const Unlock unlock(mutex);
    guarded(what);
    return true;
  };
  if (opening) {
    const Opening what = *std::exchange(opening, std::nullopt);
    return unlocked([&] { open_session(what); });
  }
  if (session == nullptr) {
    wish.reset();
    export_to.clear();
    return false;
  }
  const Clock::time_point now = Clock::now();
  if (now >= session->check_due) {
    return unlocked([&] {
      session->check_due = Clock::now() + kRepeat;
      if (animate::state_of(session->file) != session->file_state) {
        throw Error(ErrorKind::UnreadableInput,
                    fmt::format("{} changed while it was open", session->file.string()));
      }
    });
  }
  if (wish) {
    cancelled = false;
    const Wish what = *std::exchange(wish, std::nullopt);
    return unlocked([&] { do_wish(what); });
  }
  if (!export_to.empty()) {
    cancelled = false;
    const std::filesystem::path file = std::exchange(export_to, {});
    return unlocked([&] { export_keys(file); });
  }
  if (session->playing && now >= session->next_due) {
    return unlocked([&] { play_on(); });
  }
  if (!session->playing && session->last != nullptr && now >= session->repeat_due) {
    return unlocked([&] { publish(*session->last, {}); });
  }
  return false;
}

void Studio::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-studio");
  work_until_stopped();
  session.reset();
  ended = true;
}

void Studio::Impl::work_until_stopped() {
  const Lock lock(mutex);
  const auto is_asked = [&]() FACET_REQUIRES(mutex) {
    return stopping || opening || wish || !export_to.empty();
  };
  while (!stopping) {
    try {
      if (work_once()) {
        continue;
      }
    } catch (const std::bad_alloc&) {
      // There was not even the memory to say what had failed. What is asked for next finds some, or not.
      continue;
    }
    if (session == nullptr) {
      woken.wait(mutex, is_asked);
      continue;
    }
    const Clock::time_point due =
        std::min(session->check_due, session->playing ? session->next_due : session->repeat_due);
    woken.wait_until(mutex, Clock::wake(due), is_asked);
  }
}

// ---- the door -------------------------------------------------------------------------------------------

Studio::Studio(std::filesystem::path folder, Show show, std::function<void(bool)> hold_live,
               std::string software)
    : impl_(std::make_unique<Impl>(std::move(folder), std::move(show), std::move(hold_live),
                                   std::move(software))) {}

Studio::~Studio() {
  stop();
}

void Studio::start() {
  impl_->ended = false;
  try {
    impl_->thread = std::jthread([this] { impl_->run(); });
  } catch (...) {
    impl_->ended = true;
    throw;
  }
}

void Studio::request_stop() {
  const Lock lock(impl_->mutex);
  impl_->stopping = true;
  impl_->woken.notify_one();
}

bool Studio::finished() const {
  return impl_->ended;
}

void Studio::stop() {
  request_stop();
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
}

void Studio::open(const std::string& take, bool posing) {
  const std::filesystem::path file = take::named_take(impl_->folder, take);
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(file, ignored)) {
    throw Error(ErrorKind::Usage, fmt::format("there is no take {}", take));
  }
  const Lock lock(impl_->mutex);
  impl_->opening = {take, posing};
  impl_->shown.state = StudioState::Opening;
  impl_->woken.notify_one();
}

void Studio::close() {
  const Lock lock(impl_->mutex);
  impl_->opening = Impl::Opening();
  impl_->woken.notify_one();
}

std::uint64_t Studio::set_controls(const std::vector<animate::KeyControl>& controls, bool whole, bool clamp) {
  const Lock lock(impl_->mutex);
  std::vector<animate::ControlTarget> targets;
  targets.reserve(controls.size());
  for (const animate::KeyControl& control : controls) {
    targets.push_back(impl_->resolve(control));
  }
  return impl_->ask_pose(std::move(targets), {whole, clamp, true});
}

std::uint64_t Studio::move_control(const animate::KeyControl& control) {
  const Lock lock(impl_->mutex);
  const animate::ControlTarget target = impl_->resolve(control);
  std::vector<animate::ControlTarget> targets = impl_->wanted;
  const auto known = std::find_if(targets.begin(), targets.end(),
                                  [&](const auto& one) { return one.vertex == target.vertex; });
  if (known != targets.end()) {
    *known = target;
  } else {
    targets.push_back(target);
  }
  return impl_->ask_pose(std::move(targets), impl_->options);
}

std::uint64_t Studio::remove_control(const std::string& vertex) {
  const Lock lock(impl_->mutex);
  const std::int32_t number = impl_->resolve({vertex, animate::KeyControl::How::At, {0, 0, 0}}).vertex;
  std::vector<animate::ControlTarget> targets = impl_->wanted;
  const auto last =
      std::remove_if(targets.begin(), targets.end(), [&](const auto& one) { return one.vertex == number; });
  if (last == targets.end()) {
    throw Error(ErrorKind::Usage, fmt::format("vertex {} is no control point", number));
  }
  targets.erase(last, targets.end());
  return impl_->ask_pose(std::move(targets), impl_->options);
}

void Studio::play(Shown what, double from_s, bool loop) {
  const Lock lock(impl_->mutex);
  if (what != Shown::Take || impl_->shown.take.empty() || impl_->shown.state == StudioState::Opening) {
    impl_->ready_faces();
  }
  impl_->ask({Impl::Wish::Kind::Play, what, from_s, loop, {}});
}

void Studio::seek(Shown what, double time_s) {
  const Lock lock(impl_->mutex);
  if (what != Shown::Take || impl_->shown.take.empty() || impl_->shown.state == StudioState::Opening) {
    impl_->ready_faces();
  }
  impl_->ask({Impl::Wish::Kind::Seek, what, time_s, false, {}});
}

void Studio::pause() {
  const Lock lock(impl_->mutex);
  if (impl_->shown.take.empty()) {
    impl_->ready_faces();
  }
  impl_->ask({Impl::Wish::Kind::Pause, impl_->shown.shown, 0, false, {}});
}

void Studio::cancel() {
  const Lock lock(impl_->mutex);
  const bool waits_to_open = impl_->opening && !impl_->opening->take.empty();
  if (waits_to_open || impl_->shown.state == StudioState::Opening) {
    impl_->opening = Impl::Opening();
    impl_->woken.notify_one();
    return;
  }
  const bool waits = !impl_->export_to.empty();
  if (impl_->shown.state != StudioState::Preparing && impl_->shown.state != StudioState::Exporting &&
      !waits) {
    throw Error(ErrorKind::Usage, "nothing is being opened, prepared or exported");
  }
  impl_->cancelled = true;
  impl_->export_to.clear();
}

std::string Studio::keys() const {
  const Lock lock(impl_->mutex);
  impl_->ready_faces();
  return impl_->keys;
}

void Studio::set_keys(const std::string& text) {
  const animate::KeyList list = text.empty() ? animate::KeyList{} : animate::parse_keys(text, "keys");
  std::string take;
  {
    const Lock lock(impl_->mutex);
    if (impl_->opening) {
      throw Error(ErrorKind::Unavailable, "the take is still being opened");
    }
    impl_->ready_faces();
    for (const animate::Key& key : list.keys) {
      for (const animate::KeyControl& control : key.controls) {
        impl_->resolve(control);
      }
    }
    take = impl_->shown.take;
  }
  const std::filesystem::path stored = keys_file(take::named_take(impl_->folder, take));
  if (text.empty()) {
    std::error_code ignored;
    std::filesystem::remove(stored, ignored);
  } else {
    files::OutputFile file(stored);
    file.write(text);
    file.commit();
  }
  const Lock lock(impl_->mutex);
  if (impl_->shown.take == take) {
    impl_->keys = text;
  }
}

std::string Studio::save_key(double time_s) {
  // Copies: what is made of them takes long where the keys are many.
  std::string keys;
  std::vector<animate::ControlTarget> wanted;
  animate::IkOptions options;
  {
    const Lock lock(impl_->mutex);
    impl_->ready_faces();
    keys = impl_->keys;
    wanted = impl_->wanted;
    options = impl_->options;
  }
  json root = keys.empty() ? json::object() : files::parse_json(keys, animate::kKeysLimits, "keys");
  json controls = json::array();
  for (const animate::ControlTarget& target : wanted) {
    const bool on_screen = target.space == animate::ControlTarget::Space::Screen;
    json at = json::array();
    for (Eigen::Index axis = 0; axis < (on_screen ? 2 : 3); ++axis) {
      at.push_back(std::round(1e4 * static_cast<double>(target.target[axis])) / 1e4);
    }
    controls.push_back({{"vertex", target.vertex}, {on_screen ? "at_px" : "at_mm", std::move(at)}});
  }
  json kept = json::array();
  for (const json& key : root.value("keys", json::array())) {
    if (std::abs(key.at("time_s").get<double>() - time_s) > kSameTime_s) {
      kept.push_back(key);
    }
  }
  const auto later = std::find_if(kept.begin(), kept.end(),
                                  [&](const json& key) { return key.at("time_s").get<double>() > time_s; });
  // Not a braced list: that would insert its two members.
  kept.insert(later, json({{"time_s", time_s}, {"controls", std::move(controls)}}));
  root["keys"] = std::move(kept);
  root["whole"] = options.whole;
  root["clamp"] = options.clamp;
  std::string text = root.dump(1);
  set_keys(text);
  return text;
}

std::filesystem::path Studio::export_keys(const std::string& name) {
  std::filesystem::path file = take::take_path(impl_->folder, name);
  const Lock lock(impl_->mutex);
  impl_->ready_faces();
  if (impl_->keys.empty()) {
    throw Error(ErrorKind::Usage, "there are no keys yet");
  }
  if (!impl_->export_to.empty() || impl_->shown.state == StudioState::Exporting) {
    throw Error(ErrorKind::Usage, "an export is being written already");
  }
  impl_->export_to = file;
  impl_->woken.notify_one();
  return file;
}

RegionColours Studio::regions() const {
  std::shared_ptr<const animate::InfluenceMaps> maps;
  {
    const Lock lock(impl_->mutex);
    impl_->ready_faces();
    maps = impl_->maps;
  }
  RegionColours out;
  if (maps == nullptr || maps->vertices().empty()) {
    return out;
  }
  out.vertices = maps->vertices();
  for (std::size_t region = 0; region < out.vertices.size(); ++region) {
    out.colours.push_back(colour_of(maps->region_count() == 1 ? 0 : region));
  }
  const animate::RegionWeights& weights = maps->finest();
  const std::size_t count = weights.offsets.size() - 1;
  out.rgb.resize(3 * count);
  for (std::size_t v = 0; v < count; ++v) {
    Eigen::Vector3f mixed = Eigen::Vector3f::Zero();
    for (std::int32_t k = weights.offsets[v]; k < weights.offsets[v + 1]; ++k) {
      const auto entry = static_cast<std::size_t>(k);
      const auto colour = colour_of(weights.regions[entry]);
      mixed += weights.weights[entry] * Eigen::Vector3f(colour[0], colour[1], colour[2]);
    }
    for (std::size_t channel = 0; channel < 3; ++channel) {
      out.rgb[3 * v + channel] = static_cast<std::uint8_t>(
          std::lround(std::clamp(mixed[static_cast<Eigen::Index>(channel)], 0.0F, 255.0F)));
    }
  }
  return out;
}

StudioStatus Studio::status() const {
  const Lock lock(impl_->mutex);
  StudioStatus out = impl_->shown;
  out.latency = impl_->latency.figures();
  out.work = impl_->work.figures();
  return out;
}

}  // namespace facet::studio
