#pragma once

#include <filesystem>
#include <vector>

namespace facet::take {

struct Move {
  std::filesystem::path from;
  std::filesystem::path to;
};

/// Renames files and folders one after the other, none in the place of something that is there; their folders
/// are on the disk when this returns. Where one can't be moved, those before it are moved back. Any thread,
/// one for each journal at a time. Throws Error(Storage) naming what stood in the way.
/// journal: a file that names the moves while they are under way, for undo_moves after a crash
void move_all(const std::vector<Move>& moves, const std::filesystem::path& journal);

/// Moves back what a process that was killed had moved, where its journal is there still; false where there
/// is none. Throws Error(Storage) where something can't be moved back; the journal stays then.
bool undo_moves(const std::filesystem::path& journal);

/// What belongs to a take, in the order in which it is to be moved, the take's file last: whoever makes a
/// take of its name is refused until all is moved. What is not there is left out.
/// file: NAME.take. to: NAME.take of where it goes, in another folder or by another name.
std::vector<Move> moves_of_take(const std::filesystem::path& file, const std::filesystem::path& to);

}  // namespace facet::take
