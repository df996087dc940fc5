#include "service/take_methods.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "service/errands.hpp"
#include "service/take_bin.hpp"
#include "sound/sound_export.hpp"
#include "take/closing.hpp"
#include "take/cutting.hpp"
#include "take/moving.hpp"
#include "take/notes.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

constexpr std::chrono::hours kPurgePeriod{1};
constexpr int kTrimNice = 10;  ///< a trim reads and writes gigabytes beside what is recorded
/// Of a time in a take.
constexpr double kLatest_s = 1e6;

std::string utc(std::chrono::system_clock::time_point time) {
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::chrono::system_clock::to_time_t(time)));
}

json notes_json(const take::TakeNotes& notes) {
  return {{"note", notes.text}, {"slate", {{"scene", notes.scene}, {"take", notes.number}}}};
}

/// The notes with what is given in their place.
take::TakeNotes noted(take::TakeNotes notes, const json& params) {
  notes.text = params.value("note", notes.text);
  if (!params.contains("slate")) {
    return notes;
  }
  const json& slate = params.at("slate");
  if (!slate.is_object()) {
    throw Error(ErrorKind::Usage, "slate must be an object with scene and take");
  }
  for (const auto& [name, value] : slate.items()) {
    if ((name != "scene" && name != "take") || !value.is_string()) {
      throw Error(ErrorKind::Usage, "slate has scene and take, both strings, and nothing else");
    }
  }
  notes.scene = slate.value("scene", notes.scene);
  notes.number = slate.value("take", notes.number);
  return notes;
}

/// A trim, as it is told.
struct Trim {
  std::string take;
  std::string to;
  std::int64_t done = 0;
  std::int64_t total = 0;
  std::string state;  ///< "working", "done", "failed", "broken off"; "": there was none
  std::string reason;

  bool is_working() const { return state == "working"; }
};

}  // namespace

struct TakeDesk::Impl {
  Impl(TakeDeskConfig given, TakeIndex& takes, const Log& given_log)
      : config(std::move(given)), index(takes), log(given_log), bin(config.folder) {}

  const TakeDeskConfig config;
  TakeIndex& index;
  const Log& log;
  const TakeBin bin;
  mutable Mutex mutex;  ///< held for copies alone
  Trim trim FACET_GUARDED_BY(mutex);
  std::atomic<bool> cancelled{false};
  std::atomic<bool> stopping{false};
  /// The loop's own. A machine without a clock of its own gets the time from the net in its first minutes.
  Clock::time_point purge_due = Clock::now() + kPurgePeriod;
  Errands desk{"facet-takes"};
  Errands cutter{"facet-trim"};

  /// What calls a method whose work is done by the desk.
  std::function<ControlAnswer(const json&)> on_desk(json (Impl::*work)(const json&));
  std::filesystem::path existing(const std::string& name) const;
  enum class Use {
    Move,   ///< its files go elsewhere, whatever is in them
    Write,  ///< into its file
    Read,
  };
  void require_free(const std::string& name, Use use) const;
  std::filesystem::path free_take(const std::string& name, Use use) const;
  void tell(const std::string& what, const std::string& name);
  void purge_old();
  void undo_half_done(const std::function<bool()>& undo);

  // On `desk`.
  json rename(const json& params);
  json remove(const json& params);
  json restore(const json& params);
  json deleted(const json& params);
  json purge(const json& params);
  json note(const json& params);
  json begin_trim(const json& params);
  json cancel(const json& params);

  void cut(const take::CutConfig& cut);  ///< on `cutter`
  Trim trim_now() const {
    const Lock lock(mutex);
    return trim;
  }
  void end_trim(const std::string& state, const std::string& reason);
};

std::function<ControlAnswer(const json&)> TakeDesk::Impl::on_desk(json (Impl::*work)(const json&)) {
  return [this, work](const json& given) {
    return ControlAnswer(desk, [this, work, given] { return to_text((this->*work)(given)); });
  };
}

/// The file of a take that is there.
std::filesystem::path TakeDesk::Impl::existing(const std::string& name) const {
  std::filesystem::path file = take::named_take(config.folder, name);
  std::error_code error;
  if (!std::filesystem::exists(std::filesystem::symlink_status(file, error))) {
    throw Error(ErrorKind::Usage, fmt::format("there is no take '{}'", name));
  }
  return file;
}

/// Throws where somebody here works with a take of this name. Who reads it does not mind the studio.
void TakeDesk::Impl::require_free(const std::string& name, Use use) const {
  const Trim now = trim_now();
  if (config.recorded() == name) {
    throw Error(ErrorKind::Usage,
                fmt::format("take '{}' is being recorded: stop it first (record.stop)", name));
  }
  if (use != Use::Read && config.in_studio() == name) {
    throw Error(ErrorKind::Usage,
                fmt::format("take '{}' is open in the studio: close it first (studio.close)", name));
  }
  if (now.is_working() && (now.take == name || now.to == name)) {
    throw Error(ErrorKind::Usage,
                fmt::format("take '{}' is being trimmed: wait, or break that off (takes.cancel)", name));
  }
}

/// The file of a take that nobody works with: it is one closed file then, or none that can be read, where it
/// is only to be moved.
std::filesystem::path TakeDesk::Impl::free_take(const std::string& name, Use use) const {
  std::filesystem::path file = existing(name);
  require_free(name, use);
  try {
    if (const take::ClosedTake closed = take::close_take(file); !closed.left.empty()) {
      throw Error(ErrorKind::Unavailable, fmt::format("take '{}': {}", name, closed.left));
    }
  } catch (const Error& error) {
    if (use != Use::Move || error.kind() != ErrorKind::UnreadableInput) {
      throw;
    }
  }
  return file;
}

void TakeDesk::Impl::tell(const std::string& what, const std::string& name) {
  index.changed();
  log.info(fmt::format("take {}: {}, as asked over the control socket", name, what),
           {{"FACET_EVENT", "take-changed"}, {"FACET_TAKE", (config.folder / (name + ".take")).string()}});
}

json TakeDesk::Impl::rename(const json& params) {
  const std::string name = params.at("name");
  const std::string to = params.at("to");
  take::named_take(config.folder, to);
  free_take(name, Use::Move);
  require_free(to, Use::Move);
  rename_take(config.folder, name, to);
  tell(fmt::format("is called {} now", to), name);
  return {{"file", take::named_take(config.folder, to).string()}};
}

json TakeDesk::Impl::remove(const json& params) {
  const std::string name = params.at("name");
  const bool now = params.value("now", false);
  take::named_take(config.folder, name);
  // At once means for good, and of all that has the name: also of what was deleted before.
  const auto before = bin.list();
  const bool in_bin =
      std::any_of(before.begin(), before.end(), [&](const auto& take) { return take.name == name; });
  std::error_code error;
  const bool is_there =
      std::filesystem::exists(std::filesystem::symlink_status(take::named_take(config.folder, name), error));
  std::chrono::system_clock::time_point until;
  if (is_there || !(now && in_bin)) {
    free_take(name, Use::Move);
    until = bin.remove(name);
  }
  if (!now) {
    tell(fmt::format("deleted; kept until {}", utc(until)), name);
    return {{"gone", false}, {"kept_until_utc", utc(until)}};
  }
  const PurgedTakes purged = bin.purge(name);
  tell("deleted for good", name);
  return {{"gone", true}, {"takes", purged.takes}, {"bytes", purged.bytes}};
}

json TakeDesk::Impl::restore(const json& params) {
  const std::string name = params.at("name");
  const std::string to = params.value("to", name);
  take::named_take(config.folder, name);
  require_free(to, Use::Move);
  const std::filesystem::path file = bin.restore(name, to);
  tell("brought back", to);
  return {{"file", file.string()}};
}

json TakeDesk::Impl::deleted(const json& /*params*/) {
  json takes = json::array();
  for (const DeletedTake& take : bin.list()) {
    takes.push_back({{"name", take.name},
                     {"deleted_utc", utc(take.deleted)},
                     {"kept_until_utc", utc(take.deleted + TakeBin::kKept)}});
  }
  return {{"takes", std::move(takes)}};
}

json TakeDesk::Impl::purge(const json& params) {
  const PurgedTakes purged = params.contains("name") ? bin.purge(params.at("name").get<std::string>())
                                                     : bin.purge(std::chrono::milliseconds(0));
  log.info(fmt::format("{} deleted takes were removed for good ({:.1f} MB), as asked over the control socket",
                       purged.takes, static_cast<double>(purged.bytes) / 1e6));
  return {{"takes", purged.takes}, {"bytes", purged.bytes}};
}

json TakeDesk::Impl::note(const json& params) {
  const std::string name = params.at("name");
  if (!params.contains("note") && !params.contains("slate")) {
    throw Error(ErrorKind::Usage, "note or slate is missing");
  }
  const std::filesystem::path file = free_take(name, Use::Write);
  const take::TakeNotes notes = noted(take::TakeReader(file).info().notes, params);
  take::write_notes(file, notes);
  tell("has another note", name);
  return notes_json(notes);
}

json TakeDesk::Impl::begin_trim(const json& params) {
  const std::string name = params.at("name");
  const std::string to = params.at("to");
  const double from_s = params.at("from_s");
  const double to_s = params.at("to_s");
  if (!(from_s >= 0 && to_s > from_s && to_s <= kLatest_s)) {
    throw Error(ErrorKind::Usage,
                fmt::format("from_s and to_s must be from 0 to {}, the first below the second", kLatest_s));
  }
  take::CutConfig cutting;
  cutting.from = free_take(name, Use::Read);
  cutting.to = take::take_path(config.folder, to);
  require_free(to, Use::Move);
  cutting.software = config.software;
  cutting.disk_reserve_bytes = 2 * config.disk_reserve_bytes;  // a recording ends at half of it
  cutting.beside = sound::cut_beside;
  take::TakeReader reader(cutting.from);
  cutting.frames = take::frames_between(reader, from_s, to_s);
  {
    const Lock lock(mutex);
    if (trim.is_working()) {
      throw Error(ErrorKind::Unavailable,
                  fmt::format("take '{}' is being trimmed: one after the other", trim.take));
    }
    trim = {name, to, 0, cutting.frames.count(), "working", ""};
  }
  cancelled = false;
  cutter.ask([this, cutting] { cut(cutting); });
  return {{"file", cutting.to.string()}, {"frames", cutting.frames.count()}};
}

json TakeDesk::Impl::cancel(const json& /*params*/) {
  const Lock lock(mutex);
  if (!trim.is_working()) {
    throw Error(ErrorKind::Usage, "nothing is being trimmed");
  }
  cancelled = true;
  return json::object();
}

void TakeDesk::Impl::end_trim(const std::string& state, const std::string& reason) {
  const Lock lock(mutex);
  trim.state = state;
  trim.reason = reason;
}

void TakeDesk::Impl::cut(const take::CutConfig& cutting) {
  const std::string name = cutting.from.stem().string();
  try {
    const bool whole = take::cut_take(cutting, [this](std::int64_t done) {
      const Lock lock(mutex);
      trim.done = done;
      return !cancelled && !stopping;
    });
    tell(whole ? fmt::format("{} frames of it are take {} now", cutting.frames.count(),
                             cutting.to.stem().string())
               : std::string("was not trimmed: that was broken off"),
         name);
    end_trim(whole ? "done" : "broken off", "");
  } catch (const std::exception& error) {
    log.warning(fmt::format("take {} was not trimmed: {}", name, error.what()));
    end_trim("failed", error.what());
  }
}

void TakeDesk::Impl::purge_old() {
  try {
    const PurgedTakes purged = bin.purge(std::chrono::milliseconds(TakeBin::kKept));
    if (purged.takes > 0) {
      log.info(fmt::format("{} takes that were deleted {} days ago were removed for good", purged.takes,
                           TakeBin::kKept.count() / 24));
    }
  } catch (const std::exception& error) {
    log.warning(error.what());
  }
}

/// undo: true where there was something.
void TakeDesk::Impl::undo_half_done(const std::function<bool()>& undo) {
  try {
    if (undo()) {
      log.warning("a take was being moved when facetd was killed: it is where it was before");
      index.changed();
    }
  } catch (const std::exception& error) {
    log.error(fmt::format("what was half moved when facetd was killed stays so: {}", error.what()));
  }
}

TakeDesk::TakeDesk(TakeDeskConfig config, TakeIndex& index, const Log& log)
    : impl_(std::make_unique<Impl>(std::move(config), index, log)) {}

TakeDesk::~TakeDesk() {
  stop();
}

ControlMethods TakeDesk::methods() {
  using Type = ControlParam::Type;
  const ControlParam name{"name", Type::Text, true};
  const ControlParam to{"to", Type::Text, true};
  const ControlParam from_s{"from_s", Type::Number, true};
  const ControlParam to_s{"to_s", Type::Number, true};
  const auto on_desk = [this](json (Impl::*work)(const json&)) { return impl_->on_desk(work); };
  return {
      {"takes.rename", {true, {name, to}, on_desk(&Impl::rename)}},
      {"takes.delete", {true, {name, {"now", Type::Flag}}, on_desk(&Impl::remove)}},
      {"takes.restore", {true, {name, {"to", Type::Text}}, on_desk(&Impl::restore)}},
      {"takes.deleted", {true, {}, on_desk(&Impl::deleted)}},
      {"takes.purge", {true, {{"name", Type::Text}}, on_desk(&Impl::purge)}},
      {"takes.note", {true, {name, {"note", Type::Text}, {"slate"}}, on_desk(&Impl::note)}},
      {"takes.trim", {true, {name, from_s, to_s, to}, on_desk(&Impl::begin_trim)}},
      {"takes.cancel", {true, {}, on_desk(&Impl::cancel)}},
  };
}

json TakeDesk::trim_status() const {
  const Trim trim = impl_->trim_now();
  return trim.state.empty() ? json(nullptr)
                            : json{{"take", trim.take},   {"to", trim.to},       {"done", trim.done},
                                   {"total", trim.total}, {"state", trim.state}, {"reason", trim.reason}};
}

void TakeDesk::start() {
  impl_->desk.start();
  impl_->cutter.start();
  impl_->desk.ask([impl = impl_.get()] {  // before all that is asked of it
    impl->undo_half_done([impl] { return impl->bin.undo_half_done(); });
  });
  impl_->cutter.ask([impl = impl_.get()] {  // before any cut
    ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kTrimNice);
    impl->undo_half_done([impl] { return take::undo_moves(take::cutting_journal(impl->config.folder)); });
    std::error_code ignored;
    std::filesystem::remove_all(take::cutting_folder(impl->config.folder), ignored);
  });
}

void TakeDesk::look_after(Clock::time_point now) {
  if (now >= impl_->purge_due) {
    impl_->purge_due = now + kPurgePeriod;
    impl_->desk.ask([impl = impl_.get()] { impl->purge_old(); });
  }
}

void TakeDesk::request_stop() {
  impl_->stopping = true;
  impl_->desk.request_stop();
  impl_->cutter.request_stop();
}

bool TakeDesk::finished() const {
  return impl_->desk.finished() && impl_->cutter.finished();
}

void TakeDesk::stop() {
  request_stop();
  impl_->desk.stop();
  impl_->cutter.stop();
}

}  // namespace facet::service
