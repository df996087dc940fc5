#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

namespace facet::take {

/// What people wrote to a take. It stands in the take's own file (`meta`), so that it goes wherever the take
/// goes. UTF-8.
struct TakeNotes {
  std::string text;    ///< kMostNoteCharacters at most; may have line breaks
  std::string scene;   ///< of the slate; kMostSlateCharacters at most, one line
  std::string number;  ///< of the slate, likewise: which take of the scene it is

  bool operator==(const TakeNotes&) const = default;
};

inline constexpr std::size_t kMostNoteCharacters = 2000;
inline constexpr std::size_t kMostSlateCharacters = 100;

/// Throws Error(Usage) where something is longer, or has control characters.
void check_notes(const TakeNotes& notes);

/// Puts them in the place of those that a take has; all of them are on the disk when this returns, or none.
/// file: a closed take (close_take). Blocks for two seconds at most while it is in use. Any thread. Throws
/// Error(Usage) as check_notes, Error(Unavailable) where another program holds the take, Error(Storage) where
/// it can't be written.
void write_notes(const std::filesystem::path& file, const TakeNotes& notes);

/// Out of a take's `meta`, a file from outside: what check_notes refuses is cut and blanked. text_of: a key's
/// value, empty where it is not there.
TakeNotes notes_of(const std::function<std::string(std::string_view key)>& text_of);

}  // namespace facet::take
