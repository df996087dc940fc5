#include "take/closing.hpp"

#include <sqlite3.h>

#include <chrono>
#include <string_view>
#include <utility>

#include "take/database.hpp"

namespace facet::take {
namespace {

// Who only looks into a take is gone by then.
constexpr auto kPatience = std::chrono::milliseconds(200);

/// True where the file alone is the take now. A recorder's connection holds SQLite's lock of the file from
/// the first table to the end, a killed one's is gone: so nothing is folded or marked while one records.
bool end_log(Database& database, bool closed) {
  Statement mode(database, "PRAGMA journal_mode");
  const bool logged = mode.step() && mode.column_text(0) == "wal";
  mode.reset();
  if (!logged) {
    return true;
  }
  if (closed) {
    // Readers who came after the end let the log be folded in, though not its mode be left. While a take is
    // recorded, this would keep its recorder from writing.
    database.set_busy_timeout_ms(static_cast<int>(kPatience.count()));
    database.execute("PRAGMA wal_checkpoint(TRUNCATE)");
  }
  return database.end_log(kPatience);
}

/// False where its recorder has marked it itself in the meantime.
bool mark_closed(Database& database) {
  constexpr std::pair<std::string_view, std::string_view> kEntries[] = {
      {"end_reason", "broken off: its recorder was killed, failed or lost its power"}, {"closed", "1"}};
  database.execute("PRAGMA synchronous = FULL");
  database.execute("BEGIN IMMEDIATE");
  if (database.query_int64("SELECT count(*) FROM meta WHERE key = 'closed' AND value = '1'") > 0) {
    database.execute("ROLLBACK");
    return false;
  }
  Statement meta(database, "INSERT OR REPLACE INTO meta VALUES(?, ?)");
  for (const auto& [key, value] : kEntries) {
    meta.bind(1, key);
    meta.bind(2, value);
    meta.run();
  }
  database.execute("COMMIT");
  return true;
}

}  // namespace

ClosedTake close_take(const std::filesystem::path& file) {
  ClosedTake take{TakeReader(file).info(), false, ""};
  std::string obstacle = "another program records or reads it";
  try {
    Database database(file, Database::Mode::ReadWrite);
    const bool ended = end_log(database, take.info.closed);
    take.recovered = ended && !take.info.closed && mark_closed(database);
  } catch (const DatabaseError& error) {
    if (error.code() != SQLITE_BUSY) {
      obstacle = std::string("its file can't be changed (") + error.what() + ")";
    }
  }
  take.info = TakeReader(file).info();
  if (!take.info.closed) {
    take.left = "it is not closed: " + obstacle;
  } else if (log_bytes(file) > 0) {
    take.left = "a part of it is still in the -wal file beside it: " + obstacle;
  }
  return take;
}

}  // namespace facet::take
