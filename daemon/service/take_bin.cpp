#include "service/take_bin.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <optional>
#include <system_error>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "service/thumbnails.hpp"
#include "take/moving.hpp"
#include "take/recorder.hpp"

namespace facet::service {
namespace {

using Milliseconds = std::chrono::milliseconds;

bool is_there(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::exists(std::filesystem::symlink_status(path, error));
}

/// What is under way of rename, delete or restore.
std::filesystem::path journal_of(const std::filesystem::path& takes) {
  return takes / ".moves";
}

void remove_picture(const std::filesystem::path& takes, const std::string& name) {
  std::error_code ignored;
  std::filesystem::remove(Thumbnails::file(takes, name), ignored);
}

/// A new folder of the bin; two takes that are deleted within a millisecond have each its own.
std::pair<std::filesystem::path, Milliseconds> new_folder(const std::filesystem::path& bin) {
  files::make_folder(bin);
  auto now = std::chrono::floor<Milliseconds>(Clock::utc().time_since_epoch());
  while (true) {
    const std::filesystem::path folder = bin / std::to_string(now.count());
    std::error_code error;
    if (std::filesystem::create_directory(folder, error)) {
      return {folder, now};
    }
    if (error) {
      throw Error(ErrorKind::Storage,
                  fmt::format("cannot create '{}': {}", folder.string(), error.message()));
    }
    ++now;
  }
}

std::optional<Milliseconds> time_of(const std::filesystem::path& folder) {
  const std::string name = folder.filename().string();
  std::int64_t number = 0;
  const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), number);
  return error == std::errc() && end == name.data() + name.size() ? std::optional(Milliseconds(number))
                                                                  : std::nullopt;
}

PurgedTakes purge_folder(const std::filesystem::path& folder) {
  PurgedTakes purged{1, 0};
  std::error_code error;
  for (std::filesystem::recursive_directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    std::error_code unknown;
    const std::uintmax_t bytes = entry->is_regular_file(unknown) ? entry->file_size(unknown) : 0;
    purged.bytes += unknown ? 0 : bytes;
  }
  std::filesystem::remove_all(folder, error);
  if (error) {
    throw Error(ErrorKind::Storage, fmt::format("cannot remove '{}': {}", folder.string(), error.message()));
  }
  return purged;
}

}  // namespace

TakeBin::TakeBin(std::filesystem::path takes) : takes_(std::move(takes)), bin_(takes_ / ".deleted") {}

bool TakeBin::undo_half_done() const {
  const bool undone = take::undo_moves(journal_of(takes_));
  std::error_code ignored;
  for (std::filesystem::directory_iterator entry(bin_, ignored), end; !ignored && entry != end;
       entry.increment(ignored)) {
    std::error_code not_empty;  // of a take that was to come here
    if (time_of(entry->path())) {
      std::filesystem::remove(entry->path(), not_empty);
    }
  }
  return undone;
}

std::chrono::system_clock::time_point TakeBin::remove(const std::string& name) const {
  const std::filesystem::path file = take::named_take(takes_, name);
  const auto [folder, now] = new_folder(bin_);
  try {
    take::move_all(take::moves_of_take(file, folder / file.filename()), journal_of(takes_));
  } catch (const Error&) {
    std::error_code ignored;
    std::filesystem::remove(folder, ignored);
    throw;
  }
  // After the take: who draws it looks whether it is still there.
  remove_picture(takes_, name);
  return std::chrono::system_clock::time_point(now) + kKept;
}

std::filesystem::path TakeBin::restore(const std::string& name, const std::string& to) const {
  const auto all = list();
  const auto found =
      std::find_if(all.begin(), all.end(), [&](const DeletedTake& take) { return take.name == name; });
  if (found == all.end()) {
    throw Error(ErrorKind::Usage,
                fmt::format("no take '{}' was deleted in the last {} days, or it was purged", name,
                            kKept.count() / 24));
  }
  const std::filesystem::path file = take::take_path(takes_, to);
  take::move_all(take::moves_of_take(found->folder / (name + ".take"), file), journal_of(takes_));
  std::error_code ignored;
  std::filesystem::remove(found->folder, ignored);
  return file;
}

std::vector<DeletedTake> TakeBin::list() const {
  std::vector<DeletedTake> found;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(bin_, error), end; !error && entry != end;
       entry.increment(error)) {
    const auto when = time_of(entry->path());
    if (!when) {
      continue;
    }
    DeletedTake deleted{"", std::chrono::system_clock::time_point(*when), entry->path()};
    std::error_code unreadable;
    for (std::filesystem::directory_iterator part(entry->path(), unreadable), last;
         !unreadable && part != last; part.increment(unreadable)) {
      if (part->path().extension() == ".take") {
        deleted.name = part->path().stem().string();
      }
    }
    if (!deleted.name.empty()) {
      found.push_back(std::move(deleted));
    }
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.deleted > b.deleted; });
  return found;
}

PurgedTakes TakeBin::purge(Milliseconds age) const {
  PurgedTakes all;
  const auto newest = Clock::utc() - age;
  for (const DeletedTake& take : list()) {
    if (take.deleted <= newest) {
      const PurgedTakes one = purge_folder(take.folder);
      all.takes += one.takes;
      all.bytes += one.bytes;
    }
  }
  return all;
}

PurgedTakes TakeBin::purge(const std::string& name) const {
  PurgedTakes all;
  for (const DeletedTake& take : list()) {
    if (take.name == name) {
      const PurgedTakes one = purge_folder(take.folder);
      all.takes += one.takes;
      all.bytes += one.bytes;
    }
  }
  return all;
}

void rename_take(const std::filesystem::path& takes, const std::string& name, const std::string& to) {
  const std::filesystem::path file = take::named_take(takes, name);
  const std::filesystem::path target = take::take_path(takes, to);
  auto moves = take::moves_of_take(file, target);
  remove_picture(takes, to);  // of a take that is gone
  const std::filesystem::path picture = Thumbnails::file(takes, name);
  if (is_there(picture)) {
    moves.insert(moves.begin(), {picture, Thumbnails::file(takes, to)});
  }
  take::move_all(moves, journal_of(takes));
}

}  // namespace facet::service
