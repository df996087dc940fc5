#include "face/chunk_file.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "facet/error.hpp"

namespace facet::face {
namespace {

static_assert(std::endian::native == std::endian::little,
              "the file is little-endian and its arrays are copied as they are");

/// A bound that a damaged or hostile file can't pass.
constexpr std::uint32_t kMaxChunks = 64;
constexpr int kCompressionLevel = 9;  // 12 and above save under 2 % for many times the time

struct Header {
  std::array<char, 8> magic;
  std::uint32_t version;
  std::uint32_t chunk_count;
  std::uint64_t file_bytes;
  std::uint64_t table_checksum;  // of the chunk table
};
static_assert(sizeof(Header) == 32);

std::string printable(std::string tag) {
  std::replace_if(
      tag.begin(), tag.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return tag;
}

}  // namespace

std::uint64_t chunk_checksum(std::span<const std::byte> bytes) {
  constexpr std::uint64_t kOffsetBasis = 14695981039346656037ULL;
  constexpr std::uint64_t kPrime = 1099511628211ULL;
  std::uint64_t hash = kOffsetBasis;
  for (std::size_t at = 0; at < bytes.size(); at += sizeof(std::uint64_t)) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data() + at, std::min(sizeof word, bytes.size() - at));
    hash = (hash ^ word) * kPrime;
    hash ^= hash >> 32;  // FNV's multiplication alone never carries high bits downwards
  }
  return hash;
}

ChunkReader::ChunkReader(std::span<const std::byte> bytes, const std::string& source,
                         const ChunkFormat& format)
    : bytes_(bytes), source_(source), format_(format) {
  Header header{};
  if (bytes.size() < sizeof header) {
    fail("it ends inside the header");
  }
  std::memcpy(&header, bytes.data(), sizeof header);
  if (header.magic != format.magic) {
    fail(fmt::format("it is not a Facet {} (wrong magic)", format.noun));
  }
  if (header.version != format.version) {
    fail(fmt::format("it has format version {}, this program reads version {}; {}", header.version,
                     format.version, format.remedy));
  }
  if (header.file_bytes != bytes.size()) {
    fail(fmt::format("it is {} bytes long and should be {}: copied or written incompletely", bytes.size(),
                     header.file_bytes));
  }
  if (header.chunk_count > kMaxChunks ||
      bytes.size() - sizeof header < header.chunk_count * sizeof(ChunkEntry)) {
    fail(fmt::format("it claims {} chunks", header.chunk_count));
  }
  const auto table = bytes.subspan(sizeof header, header.chunk_count * sizeof(ChunkEntry));
  if (chunk_checksum(table) != header.table_checksum) {
    fail("its chunk table is damaged (checksum)");
  }
  for (std::uint32_t i = 0; i < header.chunk_count; ++i) {
    ChunkEntry entry{};
    std::memcpy(&entry, table.data() + i * sizeof entry, sizeof entry);
    const std::string tag(entry.tag.begin(), entry.tag.end());
    if (entry.offset > bytes.size() || entry.stored_bytes > bytes.size() - entry.offset ||
        entry.compressed > 1 || (entry.compressed == 0 && entry.raw_bytes != entry.stored_bytes)) {
      fail(
          fmt::format("chunk {} ('{}') lies outside the file or has an unknown encoding", i, printable(tag)));
    }
    if (!entries_.emplace(tag, entry).second) {
      fail(fmt::format("chunk '{}' is there twice", printable(tag)));
    }
  }
}

void ChunkReader::fail(const std::string& what) const {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: unreadable {}: {}", source_, format_.noun, what));
}

std::span<const std::byte> ChunkReader::raw(const char* tag) const {
  const ChunkEntry& entry = find(tag);
  if (entry.compressed != 0) {
    fail(fmt::format("chunk '{}' must not be compressed", tag));
  }
  return stored_bytes(entry, tag);
}

void ChunkReader::expect_plausible(const char* tag, std::size_t raw_bytes) const {
  const ChunkEntry& entry = find(tag);
  if (entry.raw_bytes != raw_bytes) {
    fail(fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, entry.raw_bytes, raw_bytes));
  }
  const auto stored = stored_bytes(entry, tag);
  if (entry.compressed == 1 && ZSTD_getFrameContentSize(stored.data(), stored.size()) != entry.raw_bytes) {
    fail(fmt::format("chunk '{}' does not decompress to the size its table entry says", tag));
  }
}

const ChunkEntry& ChunkReader::find(const char* tag) const {
  const auto found = entries_.find(tag);
  if (found == entries_.end()) {
    fail(fmt::format("chunk '{}' is missing", tag));
  }
  return found->second;
}

std::span<const std::byte> ChunkReader::stored_bytes(const ChunkEntry& entry, const char* tag) const {
  const auto stored = bytes_.subspan(entry.offset, entry.stored_bytes);
  if (chunk_checksum(stored) != entry.checksum) {
    fail(fmt::format("chunk '{}' is damaged (checksum)", tag));
  }
  return stored;
}

void ChunkReader::copy(const char* tag, std::span<std::byte> out) const {
  const ChunkEntry& entry = find(tag);
  if (entry.raw_bytes != out.size()) {
    fail(fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, entry.raw_bytes, out.size()));
  }
  const auto stored = stored_bytes(entry, tag);
  if (entry.compressed == 0) {
    std::memcpy(out.data(), stored.data(), stored.size());
    return;
  }
  const std::size_t got = ZSTD_decompress(out.data(), out.size(), stored.data(), stored.size());
  if (ZSTD_isError(got) != 0 || got != out.size()) {
    fail(fmt::format("chunk '{}' does not decompress to {} bytes", tag, out.size()));
  }
}

void ChunkWriter::add(const char* tag, std::span<const std::byte> raw, bool compress) {
  ChunkEntry entry{};
  std::copy_n(tag, 4, entry.tag.begin());
  entry.compressed = compress ? 1 : 0;
  entry.raw_bytes = raw.size();
  std::vector<std::byte> stored;
  if (compress) {
    stored.resize(ZSTD_compressBound(raw.size()));
    const std::size_t size =
        ZSTD_compress(stored.data(), stored.size(), raw.data(), raw.size(), kCompressionLevel);
    if (ZSTD_isError(size) != 0) {
      throw Error(ErrorKind::Internal, fmt::format("zstd: {}", ZSTD_getErrorName(size)));
    }
    stored.resize(size);
  } else {
    stored.assign(raw.begin(), raw.end());
  }
  entry.stored_bytes = stored.size();
  entry.checksum = chunk_checksum(stored);
  entries_.push_back(entry);
  chunks_.push_back(std::move(stored));
}

std::vector<std::byte> ChunkWriter::file() {
  std::uint64_t offset = sizeof(Header) + entries_.size() * sizeof(ChunkEntry);
  for (ChunkEntry& entry : entries_) {
    entry.offset = offset;
    offset += entry.stored_bytes;
  }
  const auto table = bytes_of(entries_.data(), entries_.size());
  const Header header{format_.magic, format_.version, static_cast<std::uint32_t>(entries_.size()), offset,
                      chunk_checksum(table)};
  std::vector<std::byte> all(offset);
  std::size_t at = 0;
  const auto append = [&all, &at](std::span<const std::byte> part) {
    std::copy(part.begin(), part.end(), all.begin() + static_cast<std::ptrdiff_t>(at));
    at += part.size();
  };
  append(bytes_of(&header, 1));
  append(table);
  for (const auto& chunk : chunks_) {
    append(chunk);
  }
  return all;
}

}  // namespace facet::face
