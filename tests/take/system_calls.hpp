#pragma once

#include <functional>
#include <string>

/// Calls of the system in the place of the C library's, for everything in this program, SQLite included.
namespace facet::test {

/// What happens before a file is synced to the disk; called with its path, on whatever thread. Null: nothing.
void hook_syncs(std::function<void(const std::string& path)> hook);

/// Whether a sync of a file succeeds; where it does not, it gives EIO and does nothing. Null: as the disk has
/// it.
void decide_syncs(std::function<bool(const std::string& path)> decide);

}  // namespace facet::test
