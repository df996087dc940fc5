#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// What a take file is; docs/take-format.md is its page.
namespace facet::take {

/// SQLite application_id of a take: "FCTK".
inline constexpr std::int32_t kApplicationId = 0x4643544B;
/// SQLite user_version: version of tables and blobs. History in docs/take-format.md.
inline constexpr std::int32_t kFormatVersion = 2;

/// Biggest blob, uncompressed, that is written or read (stream::kMaxMessageBytes).
inline constexpr std::size_t kMaxBlobBytes = 64U << 20;
/// The same as it is stored: what can't be compressed grows a little.
inline constexpr std::size_t kMaxStoredBytes = kMaxBlobBytes + (1U << 20);
/// Longest key or value of `meta`: the longest path of Linux. A recorder cuts what is longer, a reader
/// refuses it.
inline constexpr std::size_t kMaxMetaBytes = 4096;
inline constexpr std::size_t kMaxMetaEntries = 64;
/// What a reader hands out of the texts of `meta` but the source.
inline constexpr std::size_t kMaxShownBytes = 1024;
/// Of a take's pictures; the first is 1. 64 TiB.
inline constexpr std::int64_t kMaxSegments = 65'536;

struct TableDefinition {
  std::string_view name;
  std::string_view sql;  ///< as it stands in sqlite_schema; a reader accepts nothing else
  std::int32_t since;    ///< format version
};

/// 64-bit ids are stored as the signed integer of the same bits.
inline constexpr std::array<TableDefinition, 6> kTables{{
    {"meta", "CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT NOT NULL)", 1},
    {"subject",
     "CREATE TABLE subject(number INTEGER PRIMARY KEY, id INTEGER NOT NULL UNIQUE, data BLOB NOT NULL)", 1},
    {"albedo",
     "CREATE TABLE albedo(number INTEGER PRIMARY KEY, subject_id INTEGER NOT NULL, version INTEGER NOT NULL, "
     "data BLOB NOT NULL, UNIQUE(subject_id, version))",
     1},
    {"frame",
     "CREATE TABLE frame(number INTEGER PRIMARY KEY, sequence INTEGER NOT NULL, timestamp_ns INTEGER NOT "
     "NULL, media_time_ns INTEGER NOT NULL, state INTEGER NOT NULL, has_mesh INTEGER NOT NULL)",
     1},
    {"frame_data", "CREATE TABLE frame_data(number INTEGER PRIMARY KEY, data BLOB NOT NULL)", 1},
    {"pictures",
     "CREATE TABLE pictures(number INTEGER PRIMARY KEY, segment INTEGER NOT NULL, position INTEGER NOT NULL, "
     "bytes INTEGER NOT NULL)",
     2},
}};

/// The text, cut at `bytes` or, in UTF-8, at the character before.
std::string cut_text(std::string_view text, std::size_t bytes);

/// What a library of C made; std::bad_alloc where it could not.
template <typename T>
T* made(T* object) {
  if (object == nullptr) {
    throw std::bad_alloc();
  }
  return object;
}

/// Compresses blobs: one zstd frame each, with content size and checksum. One thread; memory is reused.
class BlobCompressor {
 public:
  /// level 1 to 19, see zstd.
  explicit BlobCompressor(int level);
  ~BlobCompressor();
  BlobCompressor(const BlobCompressor&) = delete;
  BlobCompressor& operator=(const BlobCompressor&) = delete;

  /// The result is valid until the next call.
  std::span<const std::uint8_t> compress(std::span<const std::uint8_t> message);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Decompresses one blob from outside. Throws Error(UnreadableInput) where it is damaged or longer than
/// kMaxBlobBytes. `out` is reused.
void decompress_blob(std::span<const std::uint8_t> blob, std::vector<std::uint8_t>& out);

}  // namespace facet::take
