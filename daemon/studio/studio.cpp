#include "studio/studio.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <new>
#include <optional>
#include <thread>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "mesh/hierarchy.hpp"
#include "studio/keys.hpp"
#include "studio/region_colours.hpp"
#include "studio/session.hpp"
#include "studio/times.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::studio {

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
    std::chrono::seconds lease{0};
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
  std::chrono::seconds lease FACET_GUARDED_BY(mutex){0};  ///< of the open take; 0: none
  Clock::time_point last_asked FACET_GUARDED_BY(mutex);   ///< when somebody last wanted something of it

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
  void play_on();
  void show_at(Shown what, double time_s);
  void prepare_keys();
  void export_keys(const std::filesystem::path& file);
  void publish(mesh::MeshFrame frame, std::optional<Clock::time_point> asked);
  void set_state(StudioState state);
  bool given_up();
  bool wanted_still(StudioState what);
};

// ---- whoever asks --------------------------------------------------------------------------------------

const Faces& Studio::Impl::ready_faces() const {
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
  wish->asked = last_asked = Clock::now();
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
  const Clock::time_point now = Clock::now();
  session->keep(std::move(frame), asked, now);
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
  const auto progress = [&](std::int64_t done, std::int64_t total) {
    {
      const Lock lock(mutex);
      shown.done = done;
      shown.total = total;
    }
    return !given_up();
  };
  auto made =
      std::make_unique<Session>(take::named_take(folder, what.take), what.take, what.posing, progress);
  made->check_due = Clock::now() + kRepeat;
  session = std::move(made);
  hold_live(true);
  {
    const Lock lock(mutex);
    faces = session->faces;
    keys = std::move(session->stored_keys);
    options = {};
    lease = what.lease;
    last_asked = Clock::now();
    shown.lease = lease;
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
  if (!session->keys_fault.empty()) {
    const Lock lock(mutex);
    shown.reason = std::move(session->keys_fault);
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
  frame.origin = mesh::Origin::Pose;
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

void Studio::Impl::show_at(Shown what, double time_s) {
  const double at_s = std::clamp(time_s, 0.0, session->duration_s(what));
  std::uint64_t sequence = 0;
  if (what == Shown::Keys) {
    publish(session->animated(at_s), {});
  } else {
    const Session::MeshEntry& entry = session->meshes[session->entry_at(at_s)];
    sequence = entry.sequence;
    mesh::MeshFrame frame = *session->reader->frame(entry.index, take::Pictures::Described);
    frame.origin = mesh::Origin::Take;
    publish(std::move(frame), {});
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
  if (session->is_animated(text)) {
    return;
  }
  if (text.empty()) {
    throw Error(ErrorKind::Usage, "there are no keys yet");
  }
  set_state(StudioState::Preparing);
  std::vector<std::string> warnings =
      session->make_animation(std::move(text), [this] { return wanted_still(StudioState::Preparing); });
  const Lock lock(mutex);
  shown.warnings = std::move(warnings);
}

void Studio::Impl::play_on() {
  const Shown what = *session->playing;
  const Clock::time_point now = Clock::now();
  const double time_s = session->advance(now);
  show_at(what, time_s);
  if (time_s >= session->duration_s(what)) {
    session->playing.reset();
    set_state(StudioState::Ready);
    const Lock lock(mutex);
    last_asked = now;
    return;
  }
  session->next_due = now + session->step_after(time_s);
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
      session->play(what.shown, what.time_s, what.loop, Clock::now());
      set_state(StudioState::Playing);
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
  {
    const Lock lock(mutex);
    shown.state = StudioState::Exporting;
    shown.done = 0;
    shown.total = session->animation_frames();
  }
  session->write_animation(file, software, [&](std::int64_t written) {
    const bool go_on = wanted_still(StudioState::Exporting);
    const Lock lock(mutex);
    shown.done = written;
    return go_on;
  });
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
    unlocked([&] { do_wish(what); });
    last_asked = Clock::now();  // it may have taken longer than the lease
    return true;
  }
  if (!export_to.empty()) {
    cancelled = false;
    const std::filesystem::path file = std::exchange(export_to, {});
    unlocked([&] { export_keys(file); });
    last_asked = Clock::now();
    return true;
  }
  // What plays once is watched to its end; what loops is not.
  const bool watched = session->playing && !session->loop;
  if (lease > lease.zero() && !watched && now >= last_asked + lease) {
    const std::string why = fmt::format("nobody wanted anything of take {} for {} s: the live face is back",
                                        shown.take, lease.count());
    return unlocked([&] { close_session(why); });
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
    // The lease is looked at as often as the file: twice a second.
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

void Studio::open(const std::string& take, bool posing, std::chrono::seconds lease) {
  const std::filesystem::path file = take::named_take(impl_->folder, take);
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(file, ignored)) {
    throw Error(ErrorKind::Usage, fmt::format("there is no take {}", take));
  }
  const Lock lock(impl_->mutex);
  impl_->opening = {take, posing, lease};
  impl_->shown.state = StudioState::Opening;
  impl_->woken.notify_one();
}

void Studio::close() {
  const Lock lock(impl_->mutex);
  impl_->opening = Impl::Opening();
  impl_->woken.notify_one();
}

void Studio::keep() {
  const Lock lock(impl_->mutex);
  if (impl_->shown.take.empty() && !impl_->opening) {
    impl_->ready_faces();
  }
  impl_->last_asked = Clock::now();
}

std::uint64_t Studio::set_controls(const std::vector<animate::KeyControl>& controls, bool whole,
                                   bool beyond) {
  const Lock lock(impl_->mutex);
  std::vector<animate::ControlTarget> targets;
  targets.reserve(controls.size());
  for (const animate::KeyControl& control : controls) {
    targets.push_back(impl_->resolve(control));
  }
  return impl_->ask_pose(std::move(targets), {whole, beyond, true});
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
  store_keys(take::named_take(impl_->folder, take), text);
  const Lock lock(impl_->mutex);
  if (impl_->shown.take == take) {
    impl_->keys = text;
    impl_->last_asked = Clock::now();
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
  std::string text = with_key(keys, time_s, wanted, options);
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
  return maps != nullptr ? colours_of(*maps) : RegionColours();
}

StudioStatus Studio::status() const {
  const Lock lock(impl_->mutex);
  StudioStatus out = impl_->shown;
  out.latency = impl_->latency.figures();
  out.work = impl_->work.figures();
  return out;
}

}  // namespace facet::studio
