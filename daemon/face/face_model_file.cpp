// The model file: docs/face-model-format.md describes every byte.

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <map>
#include <system_error>

#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::face {
namespace {

static_assert(std::endian::native == std::endian::little,
              "the file is little-endian and its arrays are copied as they are");

constexpr std::array<char, 8> kMagic = {'F', 'A', 'C', 'E', 'T', 'M', 'D', 'L'};
constexpr std::uint32_t kVersion = 1;

// Bounds that a damaged or hostile file can't pass.
constexpr std::size_t kMostFileBytes = std::size_t{2} << 30;
constexpr std::uint32_t kMaxChunks = 64;
constexpr std::uint32_t kMaxVertices = 1'000'000;
constexpr std::uint32_t kMaxModes = 1024;
constexpr std::uint32_t kMaxNameBytes = 255;
constexpr std::uint32_t kMaxExpressionNameBytes = 63;

constexpr float kLargestNumber = 32767.0F;  // of int16_t, the same either side of zero
constexpr float kMinStepMm = 0.001F;        // finer than any camera sees; larger zero runs compress better
constexpr int kCompressionLevel = 9;        // 12 and above save under 2 % for many times the time

struct Header {
  std::array<char, 8> magic;
  std::uint32_t version;
  std::uint32_t chunk_count;
  std::uint64_t file_bytes;
  std::uint64_t table_checksum;  // of the chunk table
};
static_assert(sizeof(Header) == 32);

struct ChunkEntry {
  std::array<char, 4> tag;
  std::uint32_t compressed;  // 0 raw, 1 one zstd frame
  std::uint64_t offset;
  std::uint64_t stored_bytes;
  std::uint64_t raw_bytes;
  std::uint64_t checksum;  // of the stored bytes
};
static_assert(sizeof(ChunkEntry) == 40);

struct Counts {
  std::uint32_t vertices;
  std::uint32_t quads;
  std::uint32_t identity_modes;
  std::uint32_t expression_modes;
  std::uint32_t landmarks;
  std::uint32_t name_bytes;
};
static_assert(sizeof(Counts) == 24);

struct StoredAnchor {
  std::array<std::int32_t, 3> vertices;
  std::array<float, 3> weights;
};
static_assert(sizeof(StoredAnchor) == 24 && sizeof(LandmarkAnchor) == 24);

/// FNV-1a over 64-bit words, the last one padded with zeros: finds damage, not malice.
std::uint64_t checksum(std::span<const std::byte> bytes) {
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

template <typename T>
std::span<const std::byte> bytes_of(const T* values, std::size_t count) {
  return {reinterpret_cast<const std::byte*>(values), count * sizeof(T)};
}

/// Chunks of one file by tag, every bound and checksum verified.
class ChunkReader {
 public:
  ChunkReader(std::span<const std::byte> bytes, const std::string& source) : bytes_(bytes), source_(source) {
    Header header{};
    if (bytes.size() < sizeof header) {
      fail("it ends inside the header");
    }
    std::memcpy(&header, bytes.data(), sizeof header);
    if (header.magic != kMagic) {
      fail("it is not a Facet face model (wrong magic)");
    }
    if (header.version != kVersion) {
      fail(
          fmt::format("it has format version {}, this program reads version {}; build the model again with "
                      "`facet model build`",
                      header.version, kVersion));
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
    if (checksum(table) != header.table_checksum) {
      fail("its chunk table is damaged (checksum)");
    }
    for (std::uint32_t i = 0; i < header.chunk_count; ++i) {
      ChunkEntry entry{};
      std::memcpy(&entry, table.data() + i * sizeof entry, sizeof entry);
      const std::string tag(entry.tag.begin(), entry.tag.end());
      if (entry.offset > bytes.size() || entry.stored_bytes > bytes.size() - entry.offset ||
          entry.compressed > 1 || (entry.compressed == 0 && entry.raw_bytes != entry.stored_bytes)) {
        fail(fmt::format("chunk {} ('{}') lies outside the file or has an unknown encoding", i,
                         printable(tag)));
      }
      if (!entries_.emplace(tag, entry).second) {
        fail(fmt::format("chunk '{}' is there twice", printable(tag)));
      }
    }
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: unreadable face model: {}", source_, what));
  }

  /// Copies a chunk of exactly count values.
  template <typename T>
  void read(const char* tag, T* values, std::size_t count) const {
    const ChunkEntry& entry = find(tag);
    if (entry.raw_bytes != count * sizeof(T)) {
      fail(fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, entry.raw_bytes,
                       count * sizeof(T)));
    }
    const auto stored = stored_bytes(entry, tag);
    if (entry.compressed == 0) {
      std::memcpy(values, stored.data(), stored.size());
      return;
    }
    const std::size_t got = ZSTD_decompress(values, count * sizeof(T), stored.data(), stored.size());
    if (ZSTD_isError(got) != 0 || got != count * sizeof(T)) {
      fail(fmt::format("chunk '{}' does not decompress to {} bytes", tag, count * sizeof(T)));
    }
  }

  /// The bytes of a raw chunk of any size.
  std::span<const std::byte> raw(const char* tag) const {
    const ChunkEntry& entry = find(tag);
    if (entry.compressed != 0) {
      fail(fmt::format("chunk '{}' must not be compressed", tag));
    }
    return stored_bytes(entry, tag);
  }

  /// Whether the compressed size of a chunk is plausible for its raw size, before memory is taken for it.
  void expect_plausible(const char* tag) const {
    const ChunkEntry& entry = find(tag);
    const auto stored = stored_bytes(entry, tag);
    if (entry.compressed == 1 && ZSTD_getFrameContentSize(stored.data(), stored.size()) != entry.raw_bytes) {
      fail(fmt::format("chunk '{}' does not decompress to the size its table entry says", tag));
    }
  }

 private:
  static std::string printable(std::string tag) {
    std::replace_if(
        tag.begin(), tag.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
    return tag;
  }

  const ChunkEntry& find(const char* tag) const {
    const auto found = entries_.find(tag);
    if (found == entries_.end()) {
      fail(fmt::format("chunk '{}' is missing", tag));
    }
    return found->second;
  }

  std::span<const std::byte> stored_bytes(const ChunkEntry& entry, const char* tag) const {
    const auto stored = bytes_.subspan(entry.offset, entry.stored_bytes);
    if (checksum(stored) != entry.checksum) {
      fail(fmt::format("chunk '{}' is damaged (checksum)", tag));
    }
    return stored;
  }

  std::span<const std::byte> bytes_;
  const std::string& source_;
  std::map<std::string, ChunkEntry> entries_;
};

/// Collects chunks and writes the file.
class ChunkWriter {
 public:
  void add(const char* tag, std::span<const std::byte> raw, bool compress) {
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
    entry.checksum = checksum(stored);
    entries_.push_back(entry);
    chunks_.push_back(std::move(stored));
  }

  std::vector<std::byte> file() {
    std::uint64_t offset = sizeof(Header) + entries_.size() * sizeof(ChunkEntry);
    for (ChunkEntry& entry : entries_) {
      entry.offset = offset;
      offset += entry.stored_bytes;
    }
    const auto table = bytes_of(entries_.data(), entries_.size());
    const Header header{kMagic, kVersion, static_cast<std::uint32_t>(entries_.size()), offset,
                        checksum(table)};
    std::vector<std::byte> all;
    all.reserve(offset);
    const auto append = [&all](std::span<const std::byte> part) {
      all.insert(all.end(), part.begin(), part.end());
    };
    append(bytes_of(&header, 1));
    append(table);
    for (const auto& chunk : chunks_) {
      append(chunk);
    }
    return all;
  }

 private:
  std::vector<ChunkEntry> entries_;
  std::vector<std::vector<std::byte>> chunks_;
};

/// Reads `count` names, each a length byte and its characters.
std::vector<std::string> parse_names(const ChunkReader& chunks, std::uint32_t count) {
  std::span<const std::byte> left = chunks.raw("EXPN");
  std::vector<std::string> names;
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::size_t length = left.empty() ? 0 : std::to_integer<std::size_t>(left[0]);
    if (length < 1 || length > kMaxExpressionNameBytes || left.size() < 1 + length) {
      chunks.fail(fmt::format("the name of expression {} is empty, too long or cut off", i));
    }
    std::string name(reinterpret_cast<const char*>(left.data()) + 1, length);
    if (std::any_of(name.begin(), name.end(), [](char c) { return c <= ' ' || c > '~'; })) {
      chunks.fail(fmt::format("the name of expression {} has a character that is not allowed", i));
    }
    names.push_back(std::move(name));
    left = left.subspan(1 + length);
  }
  if (!left.empty()) {
    chunks.fail("there are more expression names than expressions");
  }
  return names;
}

Counts parse_counts(const ChunkReader& chunks, std::string& name) {
  const auto info = chunks.raw("INFO");
  Counts counts{};
  if (info.size() < sizeof counts) {
    chunks.fail("chunk 'INFO' is cut off");
  }
  std::memcpy(&counts, info.data(), sizeof counts);
  const auto outside = [](std::uint32_t value, std::uint32_t low, std::uint32_t high) {
    return value < low || value > high;
  };
  if (outside(counts.vertices, 3, kMaxVertices) || outside(counts.quads, 1, 2 * kMaxVertices) ||
      outside(counts.identity_modes, 1, kMaxModes) || outside(counts.expression_modes, 1, kMaxModes)) {
    chunks.fail(fmt::format("impossible size: {} vertices, {} quads, {} identity modes, {} expression modes",
                            counts.vertices, counts.quads, counts.identity_modes, counts.expression_modes));
  }
  if (counts.landmarks != 0 && counts.landmarks != FaceModel::kLandmarkCount) {
    chunks.fail(
        fmt::format("it has {} landmarks (allowed: 0 or {})", counts.landmarks, FaceModel::kLandmarkCount));
  }
  if (counts.name_bytes > kMaxNameBytes || info.size() != sizeof counts + counts.name_bytes) {
    chunks.fail("its name is too long or cut off");
  }
  name.assign(reinterpret_cast<const char*>(info.data()) + sizeof counts, counts.name_bytes);
  return counts;
}

/// core = step of the row x 16-bit number.
void parse_core(const ChunkReader& chunks, std::uint64_t max_core_values, FaceModel& model) {
  const auto rows =
      static_cast<std::uint64_t>(model.identity_modes) * static_cast<std::uint64_t>(model.expression_modes);
  const auto row_values = 3 * static_cast<std::uint64_t>(model.control.vertex_count);
  if (rows * row_values > max_core_values) {
    chunks.fail(fmt::format("its core has {} numbers (allowed: {})", rows * row_values, max_core_values));
  }
  chunks.expect_plausible("CORE");
  std::vector<float> step_mm(rows);
  chunks.read("STEP", step_mm.data(), step_mm.size());
  std::vector<std::int16_t> numbers(rows * row_values);
  chunks.read("CORE", numbers.data(), numbers.size());
  model.core_mm.resize(numbers.size());
  for (std::uint64_t row = 0; row < rows; ++row) {
    const std::int16_t* from = numbers.data() + row * row_values;
    std::transform(from, from + row_values, model.core_mm.data() + row * row_values,
                   [step = step_mm[row]](std::int16_t number) { return step * static_cast<float>(number); });
  }
}

void add_core(const FaceModel& model, ChunkWriter& writer) {
  const auto row_values = 3 * static_cast<std::size_t>(model.control.vertex_count);
  const std::size_t rows = model.core_mm.size() / row_values;
  std::vector<float> step_mm(rows);
  std::vector<std::int16_t> numbers(model.core_mm.size());
  for (std::size_t row = 0; row < rows; ++row) {
    const float* from = model.core_mm.data() + row * row_values;
    const float largest = std::abs(*std::max_element(
        from, from + row_values, [](float a, float b) { return std::abs(a) < std::abs(b); }));
    step_mm[row] = std::max(largest / kLargestNumber, kMinStepMm);
    std::transform(from, from + row_values, numbers.data() + row * row_values,
                   [step = step_mm[row]](float value) {
                     return static_cast<std::int16_t>(
                         std::clamp(std::round(value / step), -kLargestNumber, kLargestNumber));
                   });
  }
  writer.add("STEP", bytes_of(step_mm.data(), rows), false);
  writer.add("CORE", bytes_of(numbers.data(), numbers.size()), true);
}

}  // namespace

FaceModel FaceModel::load(const std::filesystem::path& file) {
  std::vector<std::byte> bytes;
  try {
    bytes = files::read_bytes(file, kMostFileBytes, "face model");
  } catch (const Error& error) {
    if (error.kind() == ErrorKind::Unavailable) {
      throw;  // it may be there
    }
    throw Error(error.kind(), fmt::format("{}. `facet model build` makes it.", error.what()));
  }
  return parse(bytes, file.string());
}

FaceModel FaceModel::parse(std::span<const std::byte> bytes, const std::string& source,
                           std::uint64_t max_core_values) {
  const ChunkReader chunks(bytes, source);
  FaceModel model;
  const Counts counts = parse_counts(chunks, model.name);
  const std::size_t vertices = counts.vertices;
  model.control.vertex_count = static_cast<std::int32_t>(counts.vertices);
  model.identity_modes = static_cast<int>(counts.identity_modes);
  model.expression_modes = static_cast<int>(counts.expression_modes);

  const std::uint32_t expressions = counts.expression_modes - 1;
  model.expression_names = parse_names(chunks, expressions);
  model.expression_sigma.resize(expressions);
  chunks.read("EXPS", model.expression_sigma.data(), expressions);

  // Raw chunks first: a file that claims more than it holds fails here, before memory is taken for the core.
  const auto raw_size = [&](const char* tag, std::size_t expected) {
    if (chunks.raw(tag).size() != expected) {
      chunks.fail(
          fmt::format("chunk '{}' holds {} bytes and should hold {}", tag, chunks.raw(tag).size(), expected));
    }
  };
  raw_size("QUAD", 4 * sizeof(std::int32_t) * counts.quads);
  raw_size("TEXC", vertices * 2 * sizeof(float));
  model.control.quads.resize(4, counts.quads);
  chunks.read("QUAD", model.control.quads.data(), static_cast<std::size_t>(model.control.quads.size()));
  model.control.texture_coordinates.resize(2, static_cast<Eigen::Index>(vertices));
  chunks.read("TEXC", model.control.texture_coordinates.data(), 2 * vertices);
  model.control.refinable.resize(vertices);
  chunks.read("REFI", model.control.refinable.data(), vertices);
  model.regions.resize(vertices);
  chunks.read("REGN", model.regions.data(), vertices);
  model.mean_albedo.resize(3, static_cast<Eigen::Index>(vertices));
  chunks.read("ALBE", model.mean_albedo.data(), 3 * vertices);
  model.landmarks.resize(counts.landmarks);
  if (counts.landmarks > 0) {
    chunks.read("LAND", model.landmarks.data(), model.landmarks.size());
  }
  parse_core(chunks, max_core_values, model);

  const std::string wrong = model.check();
  if (!wrong.empty()) {
    chunks.fail(wrong);
  }
  return model;
}

void FaceModel::save(const std::filesystem::path& file) const {
  std::string wrong = check();
  if (wrong.empty() && name.size() > kMaxNameBytes) {
    wrong = fmt::format("its name has {} bytes (allowed: {})", name.size(), kMaxNameBytes);
  }
  std::vector<std::byte> names;
  for (const std::string& expression : expression_names) {
    if (expression.size() > kMaxExpressionNameBytes) {
      wrong =
          fmt::format("the expression name '{}' has more than {} bytes", expression, kMaxExpressionNameBytes);
    }
    names.push_back(static_cast<std::byte>(expression.size()));
    const auto characters = bytes_of(expression.data(), expression.size());
    names.insert(names.end(), characters.begin(), characters.end());
  }
  if (!wrong.empty()) {
    throw Error(ErrorKind::Internal,
                fmt::format("{}: the face model can't be saved: {}", file.string(), wrong));
  }

  const Counts counts{
      static_cast<std::uint32_t>(control.vertex_count), static_cast<std::uint32_t>(control.quads.cols()),
      static_cast<std::uint32_t>(identity_modes),       static_cast<std::uint32_t>(expression_modes),
      static_cast<std::uint32_t>(landmarks.size()),     static_cast<std::uint32_t>(name.size())};
  const auto counts_bytes = bytes_of(&counts, 1);
  const auto name_bytes = bytes_of(name.data(), name.size());
  std::vector<std::byte> info(counts_bytes.begin(), counts_bytes.end());
  info.insert(info.end(), name_bytes.begin(), name_bytes.end());

  ChunkWriter writer;
  const auto vertices = static_cast<std::size_t>(control.vertex_count);
  writer.add("INFO", info, false);
  writer.add("EXPN", names, false);
  writer.add("EXPS", bytes_of(expression_sigma.data(), expression_sigma.size()), false);
  writer.add("QUAD", bytes_of(control.quads.data(), static_cast<std::size_t>(control.quads.size())), false);
  writer.add("TEXC", bytes_of(control.texture_coordinates.data(), 2 * vertices), false);
  writer.add("REFI", bytes_of(control.refinable.data(), vertices), false);
  writer.add("REGN", bytes_of(regions.data(), vertices), false);
  writer.add("ALBE", bytes_of(mean_albedo.data(), 3 * vertices), false);
  if (!landmarks.empty()) {
    writer.add("LAND", bytes_of(landmarks.data(), landmarks.size()), false);
  }
  add_core(*this, writer);
  files::OutputFile output(file);
  output.write(writer.file());
  output.commit();
}

}  // namespace facet::face
