#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

namespace facet::face {

/// What tells one kind of chunk file from another.
struct ChunkFormat {
  std::array<char, 8> magic;
  std::uint32_t version;
  const char* noun;    ///< for messages: "face model"
  const char* remedy;  ///< what to do about another version
};

/// An entry of the chunk table; docs/face-model-format.md describes every byte.
struct ChunkEntry {
  std::array<char, 4> tag;
  std::uint32_t compressed;  ///< 0 raw, 1 one zstd frame
  std::uint64_t offset;
  std::uint64_t stored_bytes;
  std::uint64_t raw_bytes;
  std::uint64_t checksum;  ///< of the stored bytes
};
static_assert(sizeof(ChunkEntry) == 40);

/// FNV-1a over 64-bit words, the last one padded with zeros: finds damage, not malice.
std::uint64_t chunk_checksum(std::span<const std::byte> bytes);

/// The bytes of an array.
template <typename T>
std::span<const std::byte> bytes_of(const T* values, std::size_t count) {
  return {reinterpret_cast<const std::byte*>(values), count * sizeof(T)};
}

/// Chunks of one file by tag, every bound and checksum verified. All that it throws is Error(UnreadableInput)
/// naming the source and what is wrong.
class ChunkReader {
 public:
  /// bytes, source, format must outlive the reader.
  ChunkReader(std::span<const std::byte> bytes, const std::string& source, const ChunkFormat& format);

  [[noreturn]] void fail(const std::string& what) const;
  bool has(const char* tag) const { return entries_.contains(tag); }

  /// Copies a chunk of exactly count values.
  template <typename T>
  void read(const char* tag, T* values, std::size_t count) const {
    copy(tag, std::as_writable_bytes(std::span<T>(values, count)));
  }
  /// The bytes of a raw chunk of any size.
  std::span<const std::byte> raw(const char* tag) const;
  /// Whether a chunk says to hold so many bytes, and its compressed size is plausible for them, before memory
  /// is taken for it.
  void expect_plausible(const char* tag, std::size_t raw_bytes) const;

 private:
  const ChunkEntry& find(const char* tag) const;
  std::span<const std::byte> stored_bytes(const ChunkEntry& entry, const char* tag) const;
  void copy(const char* tag, std::span<std::byte> out) const;

  std::span<const std::byte> bytes_;
  const std::string& source_;
  const ChunkFormat& format_;
  std::map<std::string, ChunkEntry> entries_;
};

/// Collects chunks and makes the file.
class ChunkWriter {
 public:
  explicit ChunkWriter(const ChunkFormat& format) : format_(format) {}

  /// tag: four characters, once a file.
  void add(const char* tag, std::span<const std::byte> raw, bool compress);
  std::vector<std::byte> file();

 private:
  const ChunkFormat& format_;
  std::vector<ChunkEntry> entries_;
  std::vector<std::vector<std::byte>> chunks_;
};

}  // namespace facet::face
