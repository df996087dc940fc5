#include "take/moving.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/fs.h>

#include <cerrno>
#include <cstring>
#include <set>
#include <string>
#include <string_view>
#include <system_error>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "take/segment.hpp"
#include "take/take_time.hpp"

namespace facet::take {
namespace {

constexpr std::size_t kMostJournalBytes = 1 << 20;

bool is_there(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::exists(std::filesystem::symlink_status(path, error));
}

int rename_new(const std::filesystem::path& from, const std::filesystem::path& to) {
  const int moved = files::disk().rename(from.c_str(), to.c_str(), RENAME_NOREPLACE);
  if (moved == 0 || errno != EINVAL) {
    return moved;
  }
  // A file system that knows no flags: a look must do.
  if (is_there(to)) {
    errno = EEXIST;
    return -1;
  }
  return files::disk().rename(from.c_str(), to.c_str(), 0);
}

[[noreturn]] void fail(const Move& move, int error) {
  throw Error(ErrorKind::Storage, error == EEXIST
                                      ? fmt::format("'{}' is there already", move.to.string())
                                      : fmt::format("cannot move '{}' to '{}': {}", move.from.string(),
                                                    move.to.string(), std::strerror(error)));
}

/// Each path ends with a zero byte.
void write_journal(const std::vector<Move>& moves, const std::filesystem::path& journal) {
  std::string text;
  for (const Move& move : moves) {
    text += move.from.string() + '\0' + move.to.string() + '\0';
  }
  files::OutputFile out(journal);
  out.write(text);
  out.commit();
}

void end_journal(const std::filesystem::path& journal) {
  std::error_code error;
  if (!std::filesystem::remove(journal, error) && error) {
    throw Error(ErrorKind::Storage, fmt::format("cannot remove '{}': {}", journal.string(), error.message()));
  }
}

}  // namespace

void move_all(const std::vector<Move>& moves, const std::filesystem::path& journal) {
  std::set<std::filesystem::path> folders;
  write_journal(moves, journal);
  for (std::size_t done = 0; done < moves.size(); ++done) {
    const auto& [from, to] = moves[done];
    if (rename_new(from, to) == 0) {
      folders.insert({from.parent_path(), to.parent_path()});
      continue;
    }
    const int error = errno;
    while (done-- > 0) {
      rename_new(moves[done].to, moves[done].from);
    }
    end_journal(journal);
    fail({from, to}, error);
  }
  for (const std::filesystem::path& folder : folders) {
    files::sync_folder(folder);
  }
  end_journal(journal);
}

bool undo_moves(const std::filesystem::path& journal) {
  if (!is_there(journal)) {
    return false;
  }
  const std::string text = files::read_text(journal, kMostJournalBytes, "list of moves");
  std::vector<std::filesystem::path> paths;
  for (std::string_view rest = text; rest.find('\0') != std::string_view::npos;) {
    const std::size_t end = rest.find('\0');
    paths.emplace_back(rest.substr(0, end));
    rest.remove_prefix(end + 1);
  }
  std::set<std::filesystem::path> folders;
  for (std::size_t end = paths.size() / 2 * 2; end > 0; end -= 2) {
    const Move back{paths[end - 1], paths[end - 2]};
    if (is_there(back.from) && !is_there(back.to)) {
      if (rename_new(back.from, back.to) != 0) {
        fail(back, errno);
      }
      folders.insert({back.from.parent_path(), back.to.parent_path()});
    }
  }
  for (const std::filesystem::path& folder : folders) {
    files::sync_folder(folder);
  }
  end_journal(journal);
  return true;
}

std::vector<Move> moves_of_take(const std::filesystem::path& file, const std::filesystem::path& to) {
  std::vector<Move> moves;
  const auto add = [&](const std::filesystem::path& from, const std::filesystem::path& target) {
    if (is_there(from)) {
      moves.push_back({from, target});
    }
  };
  add(segments_folder(file), segments_folder(to));
  add(sound_file_of(file), sound_file_of(to));
  for (const char* made_of_it : {".keys.json", ".basis"}) {
    add(std::filesystem::path(file).replace_extension(made_of_it),
        std::filesystem::path(to).replace_extension(made_of_it));
  }
  // SQLite's own, of a take that could not be closed.
  for (const char* suffix : {"-wal", "-shm", "-journal"}) {
    add(file.string() + suffix, to.string() + suffix);
  }
  add(file, to);
  return moves;
}

}  // namespace facet::take
