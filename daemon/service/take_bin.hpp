#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace facet::service {

/// A take that was deleted and can be brought back.
struct DeletedTake {
  std::string name;
  std::chrono::system_clock::time_point deleted;
  std::filesystem::path folder;  ///< that holds it and nothing else
};

/// What was removed for good.
struct PurgedTakes {
  int takes = 0;
  std::uint64_t bytes = 0;
};

/// Takes that were deleted: each with all that is made of it in a folder FOLDER/.deleted/MILLISECONDS of its
/// own, named by the time (UTC). Blocks on the disk; one thread at a time. Throws Error(Storage) naming what
/// can't be moved or removed.
class TakeBin {
 public:
  static constexpr std::chrono::hours kKept{7 * 24};

  explicit TakeBin(std::filesystem::path takes);

  /// Undoes what a process that was killed had half done. Before the first of the others; true: there was
  /// something.
  bool undo_half_done() const;

  /// A closed take goes into the bin, whole or not at all; its picture goes for good. Returns when it is
  /// purged.
  std::chrono::system_clock::time_point remove(const std::string& name) const;
  /// The one of this name that was deleted last comes back. to: its name then; nothing of that name may be
  /// there. Throws Error(Usage) where there is none.
  std::filesystem::path restore(const std::string& name, const std::string& to) const;
  /// Newest first. What lies there without a take is left alone.
  std::vector<DeletedTake> list() const;
  /// Removes for good what was deleted so long ago, by the machine's clock.
  PurgedTakes purge(std::chrono::milliseconds age) const;
  /// The same of all that had a name.
  PurgedTakes purge(const std::string& name) const;

 private:
  std::filesystem::path takes_;
  std::filesystem::path bin_;
};

/// A take and all that is made of it gets another name; nothing of that name may be there. Not while a
/// TakeBin of the same takes works (they share their journal, TakeBin::undo_half_done).
void rename_take(const std::filesystem::path& takes, const std::string& name, const std::string& to);

}  // namespace facet::service
