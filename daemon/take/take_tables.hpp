#pragma once

#include <chrono>
#include <string>
#include <string_view>

#include "take/database.hpp"
#include "take/segment.hpp"

/// How a take's file begins, whoever makes it: a recorder or a cut.
namespace facet::take {

/// Of a take's index: frame blobs are tens to hundreds of kilobytes, bigger pages mean shorter chains of
/// them.
inline constexpr int kPageBytes = 16384;

/// What a new take says of itself from the start. source, software: cut where they are too long for `meta`.
struct TakeOrigin {
  std::string_view source;
  std::string_view software;
  TakeId id{};
};

/// Marks an empty database as a take and makes its tables, with what it says of itself; in the open
/// transaction.
void make_tables(Database& database, const TakeOrigin& origin);

/// As `meta` and names have it. format: of fmt.
std::string utc_text(std::chrono::system_clock::time_point time, const char* format);

}  // namespace facet::take
