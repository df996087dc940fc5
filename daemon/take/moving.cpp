#include "take/moving.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/fs.h>

#include <cerrno>
#include <cstring>
#include <set>
#include <system_error>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "files/output_file.hpp"
#include "take/segment.hpp"
#include "take/take_time.hpp"

namespace facet::take {
namespace {

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

}  // namespace

void move_all(const std::vector<Move>& moves) {
  std::set<std::filesystem::path> folders;
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
    throw Error(ErrorKind::Storage, error == EEXIST
                                        ? fmt::format("'{}' is there already", to.string())
                                        : fmt::format("cannot move '{}' to '{}': {}", from.string(),
                                                      to.string(), std::strerror(error)));
  }
  for (const std::filesystem::path& folder : folders) {
    files::sync_folder(folder);
  }
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
