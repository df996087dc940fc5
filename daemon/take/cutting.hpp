#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "take/reader.hpp"
#include "take/take_time.hpp"

namespace facet::take {

/// Frames of a take, FrameEntry::index, both included.
struct FrameSpan {
  std::int64_t first = 0;
  std::int64_t last = 0;

  std::int64_t count() const { return last - first + 1; }
};

/// The frames from one time to another, both included. from_s, to_s: as a replay counts, from the take's
/// first mesh (of a take without one: from its first frame). Throws Error(Usage) where there is no frame
/// between them.
FrameSpan frames_between(TakeReader& take, double from_s, double to_s);

struct CutConfig {
  std::filesystem::path from;  ///< a closed take
  FrameSpan frames;
  std::filesystem::path to;  ///< NAME.take, nothing of whose name is there
  std::string software;      ///< for people: program and version
  /// It ends with a reason while this much of the disk is still free, bytes.
  std::uint64_t disk_reserve_bytes = 256ULL << 20;
  /// Makes what stands beside the new take `file`, of the time from its first frame to the end of its last
  /// (timestamp_ns), and returns what its `meta` is to say of it. Null: nothing.
  std::function<MetaEntries(const TakeInfo& from, std::int64_t from_ns, std::int64_t to_ns,
                            const std::filesystem::path& file)>
      beside;
};

/// Copies a span of a take's frames into a new take, with the subjects, albedos and pictures that they refer
/// to, its notes, its timecode and what `beside` makes. All is copied as it is stored, so nothing loses any
/// precision; checksums are looked at. It is made in the folder `.cutting` beside it and appears whole, on
/// the disk, or not at all. One cut at a time in a folder. Blocks on the disk. progress: called after each
/// frame with the number of those that are done; false: it is broken off. Returns false where it was broken
/// off. Throws Error(UnreadableInput) where the take is damaged, Error(Storage) where the new one can't be
/// written or its name was taken meanwhile.
bool cut_take(const CutConfig& config, const std::function<bool(std::int64_t done)>& progress);

/// Where a cut is made, of a folder of takes; what is in it while none is made is left over.
std::filesystem::path cutting_folder(const std::filesystem::path& takes);
/// The journal of the moves by which a cut gets its place (undo_moves, before the folder is emptied).
std::filesystem::path cutting_journal(const std::filesystem::path& takes);

}  // namespace facet::take
