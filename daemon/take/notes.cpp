#include "take/notes.hpp"

#include <fmt/format.h>
#include <sqlite3.h>

#include <algorithm>
#include <utility>

#include "facet/error.hpp"
#include "take/database.hpp"
#include "take/take_file.hpp"

namespace facet::take {
namespace {

constexpr int kBusyTimeout_ms = 2000;

bool begins_character(char byte) {
  return (static_cast<unsigned char>(byte) & 0xC0U) != 0x80U;
}

std::size_t characters(std::string_view text) {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), begins_character));
}

/// Where many_lines, line breaks and tabs are none.
bool is_control(char byte, bool many_lines) {
  const auto code = static_cast<unsigned char>(byte);
  const bool breaks = byte == '\n' || byte == '\t';
  return (code < 0x20 && !(many_lines && breaks)) || code == 0x7F;
}

void check(std::string_view what, std::string_view text, std::size_t most, bool many_lines) {
  if (const std::size_t count = characters(text); count > most) {
    throw Error(ErrorKind::Usage, fmt::format("{} has {} characters; {} are the most", what, count, most));
  }
  if (std::any_of(text.begin(), text.end(), [&](char byte) { return is_control(byte, many_lines); })) {
    throw Error(ErrorKind::Usage, fmt::format("{} has a control character", what));
  }
}

std::string cleaned(std::string text, std::size_t most, bool many_lines) {
  std::replace_if(
      text.begin(), text.end(), [&](char byte) { return is_control(byte, many_lines); }, ' ');
  std::size_t count = 0;
  const auto end = std::find_if(text.begin(), text.end(),
                                [&](char byte) { return begins_character(byte) && ++count > most; });
  text.erase(end, text.end());
  return text;
}

}  // namespace

void check_notes(const TakeNotes& notes) {
  check("the note", notes.text, kMostNoteCharacters, true);
  check("the slate's scene", notes.scene, kMostSlateCharacters, false);
  check("the slate's take", notes.number, kMostSlateCharacters, false);
}

void write_notes(const std::filesystem::path& file, const TakeNotes& notes) {
  check_notes(notes);
  // A value of `meta` has 4 KiB at most, 2000 characters of UTF-8 may have twice as much.
  const std::string begin = cut_text(notes.text, kMaxMetaBytes);
  const std::pair<std::string_view, std::string> entries[] = {{"note", begin},
                                                              {"note_more", notes.text.substr(begin.size())},
                                                              {"scene", notes.scene},
                                                              {"scene_take", notes.number}};
  try {
    Database database(file, Database::Mode::ReadWrite);
    database.set_busy_timeout_ms(kBusyTimeout_ms);
    database.execute("PRAGMA synchronous = FULL");
    database.execute("BEGIN IMMEDIATE");
    Statement put(database, "INSERT OR REPLACE INTO meta VALUES(?, ?)");
    Statement remove(database, "DELETE FROM meta WHERE key = ?");
    for (const auto& [key, value] : entries) {
      Statement& change = value.empty() ? remove : put;
      change.bind(1, key);
      if (!value.empty()) {
        change.bind(2, std::string_view(value));
      }
      change.run();
    }
    database.execute("COMMIT");
  } catch (const DatabaseError& error) {
    const bool busy = error.code() == SQLITE_BUSY || error.code() == SQLITE_LOCKED;
    throw Error(busy ? ErrorKind::Unavailable : ErrorKind::Storage,
                fmt::format("take '{}': {}", file.string(),
                            busy ? std::string("another program reads it: try again")
                                 : fmt::format("its notes can't be written ({})", error.what())));
  }
}

TakeNotes notes_of(const std::function<std::string(std::string_view key)>& text_of) {
  return {cleaned(text_of("note") + text_of("note_more"), kMostNoteCharacters, true),
          cleaned(text_of("scene"), kMostSlateCharacters, false),
          cleaned(text_of("scene_take"), kMostSlateCharacters, false)};
}

}  // namespace facet::take
