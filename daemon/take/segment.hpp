#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

/// The files beside a take that hold its pictures, NAME.frames/000001.seg ...; docs/take-format.md is the
/// page.
namespace facet::take {

inline constexpr std::uint32_t kSegmentVersion = 1;
/// Drawn by lot for each take: a segment of another one is noticed.
using TakeId = std::array<std::uint8_t, 16>;

TakeId new_take_id();
/// 32 hexadecimal digits; the other way round, all 0 where they are none.
std::string to_text(const TakeId& id);
TakeId take_id_from(const std::string& text);

/// The folder NAME.frames of the take NAME.take.
std::filesystem::path segments_folder(const std::filesystem::path& take);
std::filesystem::path segment_file(const std::filesystem::path& take, std::int64_t number);

/// A file under the name that it was made under, for as long as it is open: only then is its inode its own.
struct NamedFile {
  std::filesystem::path path;
  dev_t device = 0;
  ino_t inode = 0;

  /// Throws Error(Storage).
  static NamedFile of(const std::filesystem::path& path);
  /// True where the name still leads to the file, false where that can't be seen now. Throws Error(Storage)
  /// where it leads to nothing or to another file.
  bool is_there() const;
};

/// Where a frame's records lie.
struct Extent {
  std::int64_t segment = 0;   ///< from 1
  std::int64_t position = 0;  ///< of the first byte, in the segment's file
  std::int64_t bytes = 0;
};

/// Writes segments one after the other, each sequentially. One thread; blocks on the disk. Throws
/// Error(Storage) naming the file. The descriptor of the next segment is held in reserve where the file
/// system allows it: a process that has none left goes on recording.
class SegmentWriter {
 public:
  /// Makes the folder, which must not be there yet; its name is on the disk when the caller has synced the
  /// folder above. segment_bytes: a segment is ended before it would be longer; a frame that is longer alone
  /// has one for itself.
  SegmentWriter(const std::filesystem::path& take, const TakeId& id, std::uint64_t segment_bytes);
  /// As close.
  ~SegmentWriter();
  SegmentWriter(const SegmentWriter&) = delete;
  SegmentWriter& operator=(const SegmentWriter&) = delete;

  Extent append(std::span<const std::uint8_t> records);
  /// All that was appended is on the disk when this returns, under the files' names.
  void sync();
  /// Whether the segment that is written is still what its name leads to, as NamedFile::is_there.
  bool is_there() const;
  /// The same of every segment: under its name, and as long as it was written.
  bool are_all_there() const;
  /// Cuts off what was appended since the last sync and removes a folder without segments. Idempotent, never
  /// throws.
  void close();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Reads segments, files from outside. One thread. Throws Error(UnreadableInput) with the segment's name (the
/// take's is the caller's to add) and what is wrong: missing, not one of this take, too short.
class SegmentReader {
 public:
  SegmentReader(std::filesystem::path take, const TakeId& id);
  ~SegmentReader();
  SegmentReader(SegmentReader&&) noexcept;
  SegmentReader& operator=(SegmentReader&&) noexcept;

  /// Valid until the next call.
  std::span<const std::uint8_t> read(const Extent& extent);
  /// Opens a segment and checks its head; its length, bytes.
  std::uint64_t check(std::int64_t number);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::take
