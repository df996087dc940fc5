#include "service/take_index.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <ctime>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string_view>
#include <system_error>
#include <tuple>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "take/closing.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

/// A list is good for this many times what making it took, and for at least kLeastAge.
constexpr int kRestPerWork = 10;
constexpr std::chrono::milliseconds kLeastAge{100};

/// As a file was when it was read. Another inode under the name, a change of its contents or of its log
/// beside it makes another state.
struct FileState {
  std::uint64_t device = 0;
  std::uint64_t inode = 0;
  std::int64_t bytes = 0;
  std::int64_t changed_ns = 0;
  std::int64_t log_bytes = -1;  ///< -1: there is none
  std::int64_t log_changed_ns = 0;

  bool operator==(const FileState&) const = default;
};

std::int64_t nanoseconds(const timespec& time) {
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

/// Nothing where it is no regular file.
std::optional<FileState> state_of(const std::filesystem::path& file) {
  struct stat status {};
  if (::stat(file.c_str(), &status) != 0 || !S_ISREG(status.st_mode)) {
    return std::nullopt;
  }
  FileState state;
  state.device = status.st_dev;
  state.inode = status.st_ino;
  state.bytes = status.st_size;
  state.changed_ns = nanoseconds(status.st_mtim);
  struct stat log {};
  if (::stat((file.string() + "-wal").c_str(), &log) == 0) {
    state.log_bytes = log.st_size;
    state.log_changed_ns = nanoseconds(log.st_mtim);
  }
  return state;
}

/// Newest first as they were made: a note that is written to an old take does not make it new. What does not
/// say when it was made counts by its file's last change.
void put_in_order(std::vector<json>& entries,
                  const std::vector<std::pair<std::filesystem::path, FileState>>& files) {
  std::vector<std::pair<std::string, json>> dated;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    const auto changed_s = static_cast<std::time_t>(files[i].second.changed_ns / 1'000'000'000);
    std::string when = entries[i].value("created_utc", "");
    dated.emplace_back(
        when.empty() ? fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(changed_s)) : std::move(when),
        std::move(entries[i]));
  }
  std::stable_sort(dated.begin(), dated.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::transform(dated.begin(), dated.end(), entries.begin(),
                 [](std::pair<std::string, json>& one) { return std::move(one.second); });
}

}  // namespace

struct TakeIndex::Impl {
  struct Known {
    FileState state;
    std::optional<take::TakeInfo> info;  ///< none: `error` says why
    std::string error;
  };

  Impl(std::filesystem::path takes, Thumbnails& drawer) : folder(std::move(takes)), thumbnails(drawer) {}

  const std::filesystem::path folder;
  Thumbnails& thumbnails;
  std::atomic<std::uint64_t> number{0};
  std::atomic<std::uint64_t> reads{0};

  Mutex listing;                               ///< held while the folder is looked at
  std::string text FACET_GUARDED_BY(listing);  ///< the last list
  Clock::time_point good_until FACET_GUARDED_BY(listing);
  std::atomic<bool> stale{true};
  std::atomic<bool> asked{false};  ///< somebody wants to see the takes, with pictures

  Mutex mutex;                                                 ///< held for look-ups alone
  std::map<std::string, Known> known FACET_GUARDED_BY(mutex);  ///< by the file's path

  Known read(const std::filesystem::path& file, const FileState& state);
  json entry_of(const std::filesystem::path& file, const FileState& state);
  std::vector<std::pair<std::filesystem::path, FileState>> files() const;
  std::string make_list();
};

/// What is known of a file as it is, read where it is not known.
TakeIndex::Impl::Known TakeIndex::Impl::read(const std::filesystem::path& file, const FileState& state) {
  {
    const Lock lock(mutex);
    const auto found = known.find(file.native());
    if (found != known.end() && found->second.state == state) {
      return found->second;
    }
  }
  Known fresh{state, std::nullopt, ""};
  ++reads;
  try {
    fresh.info = take::listed_info(file);
  } catch (const Error& unreadable) {
    fresh.error = unreadable.what();
    if (unreadable.kind() == ErrorKind::Unavailable) {
      return fresh;  // not kept: what another program does to the file leaves no trace in its state
    }
  }
  const Lock lock(mutex);
  known.insert_or_assign(file.native(), fresh);
  return fresh;
}

json TakeIndex::Impl::entry_of(const std::filesystem::path& file, const FileState& state) {
  const std::string name = file.stem().string();
  json entry = {{"name", name}, {"file", file.string()}};
  try {
    take::named_take(folder, name);  // what no method takes is not offered
    const Known take = read(file, state);
    if (!take.info) {
      entry["error"] = take.error;
      return entry;
    }
    const take::TakeInfo& info = *take.info;
    entry["created_utc"] = info.created_utc;
    entry["frames"] = info.frame_count;
    entry["mesh_frames"] = info.mesh_frame_count;
    entry["duration_s"] = info.duration_s;
    entry["bytes"] = info.file_bytes;
    entry["picture_bytes"] = info.picture_bytes;
    std::error_code no_sound;
    const std::uintmax_t sound_bytes =
        info.sound.is_there() ? std::filesystem::file_size(take::sound_file_of(file), no_sound) : 0;
    if (!no_sound && sound_bytes > 0) {
      entry["sound_bytes"] = sound_bytes;
    }
    entry["closed"] = info.closed;
    entry["end_reason"] = info.end_reason;
    if (!info.notes.text.empty()) {
      entry["note"] = info.notes.text;
    }
    if (!info.notes.scene.empty() || !info.notes.number.empty()) {
      entry["slate"] = {{"scene", info.notes.scene}, {"take", info.notes.number}};
    }
    if (!info.cut_from.empty()) {
      entry["cut_from"] = info.cut_from;
    }
    if (asked && info.closed && info.mesh_frame_count > 0) {
      if (const auto stamp = thumbnails.ask(name)) {
        entry["thumbnail"] = *stamp;
      }
    }
  } catch (const Error& unusable) {
    entry["error"] = unusable.what();
  }
  return entry;
}

/// Of the folder, newest first.
std::vector<std::pair<std::filesystem::path, FileState>> TakeIndex::Impl::files() const {
  std::vector<std::pair<std::filesystem::path, FileState>> found;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->path().extension() == ".take") {
      if (const auto state = state_of(entry->path())) {
        found.emplace_back(entry->path(), *state);
      }
    }
  }
  if (error) {
    throw Error(ErrorKind::Storage, folder.string() + ": cannot list this folder: " + error.message());
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) {
    return std::tie(b.second.changed_ns, a.first) < std::tie(a.second.changed_ns, b.first);
  });
  return found;
}

std::string TakeIndex::Impl::make_list() {
  auto found = files();
  const std::size_t count = found.size();
  found.resize(std::min(count, kMostListed));
  std::vector<json> entries;
  entries.reserve(found.size());
  for (const auto& [file, state] : found) {
    entries.push_back(entry_of(file, state));
  }
  put_in_order(entries, found);
  {
    // Nothing is kept of takes that are no longer there, nor of those that are no longer listed.
    std::set<std::string_view> listed;
    for (const auto& [file, state] : found) {
      listed.insert(file.native());
    }
    const Lock lock(mutex);
    std::erase_if(known, [&](const auto& entry) { return listed.count(entry.first) == 0; });
  }
  const json list = {{"folder", folder.string()}, {"count", count}, {"takes", std::move(entries)}};
  return list.dump(-1, ' ', false, json::error_handler_t::replace);
}

TakeIndex::TakeIndex(std::filesystem::path folder, Thumbnails& thumbnails)
    : impl_(std::make_unique<Impl>(std::move(folder), thumbnails)) {}

TakeIndex::~TakeIndex() = default;

std::string TakeIndex::list() {
  if (!impl_->asked.exchange(true)) {
    changed();
  }
  look();
  const Lock lock(impl_->listing);
  return impl_->text;
}

void TakeIndex::look() {
  const Lock lock(impl_->listing);
  const Clock::time_point began = Clock::now();
  if (impl_->stale.exchange(false) || began >= impl_->good_until) {
    std::string text = impl_->make_list();
    const Clock::time_point made = Clock::now();
    impl_->good_until = made + std::max<Clock::duration>(kLeastAge, kRestPerWork * (made - began));
    if (text != impl_->text) {
      impl_->text = std::move(text);
      ++impl_->number;
    }
  }
}

void TakeIndex::changed() {
  impl_->stale = true;
}

bool TakeIndex::stale() const {
  return impl_->stale;
}

std::uint64_t TakeIndex::number() const {
  return impl_->number;
}

std::uint64_t TakeIndex::reads() const {
  return impl_->reads;
}

void TakeIndex::close_broken_off(const Log& log, const std::function<bool()>& go_on) {
  std::vector<std::pair<std::filesystem::path, FileState>> found;
  try {
    found = impl_->files();
  } catch (const Error& error) {
    log.warning(error.what());
    return;
  }
  for (std::size_t i = 0; i < found.size() && go_on(); ++i) {
    const auto& [file, state] = found[i];
    const bool listed = i < kMostListed;
    if (state.log_bytes < 0 && !listed) {
      continue;
    }
    try {
      if (state.log_bytes < 0) {
        const Impl::Known take = impl_->read(file, state);
        if (!take.info || take.info->closed) {
          continue;
        }
      }
      const take::ClosedTake take = take::close_take(file);
      if (take.recovered) {
        log.warning(fmt::format("take {} had been broken off: closed now with {} frames", file.string(),
                                take.info.frame_count),
                    {{"FACET_EVENT", "take-recovered"}, {"FACET_TAKE", take.info.file.string()}});
      } else if (!take.left.empty()) {
        log.warning(fmt::format("take {}: {}", file.string(), take.left));
      }
      changed();
    } catch (const Error& unreadable) {
      log.warning(unreadable.what());
    }
  }
}

}  // namespace facet::service
