#include "take/take_tables.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <utility>

#include "facet/clock.hpp"
#include "take/take_file.hpp"

namespace facet::take {

void make_tables(Database& database, const TakeOrigin& origin) {
  database.execute(fmt::format("PRAGMA application_id = {}", kApplicationId));
  database.execute(fmt::format("PRAGMA user_version = {}", kFormatVersion));
  for (const TableDefinition& table : kTables) {
    database.execute(std::string(table.sql));
  }
  Statement meta(database, "INSERT INTO meta VALUES(?, ?)");
  const std::pair<std::string_view, std::string> entries[] = {
      {"source", std::string(origin.source)},
      {"software", std::string(origin.software)},
      {"take_id", to_text(origin.id)},
      {"created_utc", utc_text(Clock::utc(), "{:%Y-%m-%dT%H:%M:%SZ}")}};
  for (const auto& [key, value] : entries) {
    const std::string stored = cut_text(value, kMaxMetaBytes);
    meta.bind(1, key);
    meta.bind(2, std::string_view(stored));
    meta.run();
  }
}

std::string utc_text(std::chrono::system_clock::time_point time, const char* format) {
  const auto seconds = std::chrono::system_clock::to_time_t(time);
  return fmt::format(fmt::runtime(format), fmt::gmtime(seconds));
}

}  // namespace facet::take
