#include "avatar/glb_document.hpp"

#include <fmt/format.h>

#include <bit>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::avatar {
namespace {

using Json = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little);

// Numbers of the glTF 2.0 specification.
constexpr std::uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinaryChunk = 0x004E4942;
constexpr int kFloat = 5126;
constexpr std::size_t kHeadBytes = 12;
constexpr std::size_t kChunkHeadBytes = 8;
/// Avatars have some megabytes of it; documents nest a dozen deep, but what extensions hold may nest deeper.
constexpr files::JsonLimits kJsonLimits{64U << 20, 4'000'000, 100};

std::uint32_t word(std::span<const std::byte> bytes, std::size_t at) {
  std::uint32_t value = 0;
  std::memcpy(&value, bytes.data() + at, sizeof(value));
  return value;
}

struct Chunk {
  std::uint32_t type = 0;
  std::span<const std::byte> content;
};

Chunk take_chunk(std::span<const std::byte>& rest) {
  if (rest.size() < kChunkHeadBytes || word(rest, 0) > rest.size() - kChunkHeadBytes) {
    throw std::runtime_error("it is cut off");
  }
  const Chunk chunk{word(rest, 4), rest.subspan(kChunkHeadBytes, word(rest, 0))};
  rest = rest.subspan(kChunkHeadBytes + chunk.content.size());
  return chunk;
}

/// Throws std::exception saying what is wrong.
GlbDocument parse(std::span<const std::byte> bytes) {
  if (bytes.size() < kHeadBytes || word(bytes, 0) != kMagic) {
    throw std::runtime_error("it is no GLB file (binary glTF)");
  }
  if (word(bytes, 4) != 2) {
    throw std::runtime_error(fmt::format("it is glTF {}, 2 is wanted", word(bytes, 4)));
  }
  if (word(bytes, 8) < kHeadBytes || word(bytes, 8) > bytes.size()) {
    throw std::runtime_error("it is cut off");
  }
  std::span<const std::byte> rest = bytes.subspan(kHeadBytes, word(bytes, 8) - kHeadBytes);
  const Chunk text = take_chunk(rest);
  if (text.type != kJsonChunk) {
    throw std::runtime_error("its first chunk is not JSON");
  }
  GlbDocument glb;
  glb.json = files::parse_ordered_json(
      {reinterpret_cast<const char*>(text.content.data()), text.content.size()}, kJsonLimits, "its JSON");
  if (!glb.json.is_object()) {
    throw std::runtime_error("its JSON is no object");
  }
  const bool has_buffer = glb.json.contains("buffers") && !glb.json.at("buffers").empty();
  if (has_buffer) {
    const Json& buffer = glb.json.at("buffers").at(0);
    const auto length = buffer.at("byteLength").get<std::uint64_t>();
    const Chunk binary = rest.empty() ? Chunk() : take_chunk(rest);
    if (buffer.contains("uri") || binary.type != kBinaryChunk) {
      throw std::runtime_error("its data are in another file: export the avatar as one GLB");
    }
    if (length > binary.content.size()) {
      throw std::runtime_error("its buffer is cut off");
    }
    glb.binary.assign(binary.content.begin(), binary.content.begin() + static_cast<std::ptrdiff_t>(length));
  }
  return glb;
}

}  // namespace

GlbDocument parse_glb(std::span<const std::byte> bytes, const std::string& source) {
  try {
    return parse(bytes);
  } catch (const std::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", source, error.what()));
  }
}

GlbDocument read_glb(const std::filesystem::path& file) {
  const std::string bytes = files::read_text(file, kMostGlbBytes, "avatar");
  return parse_glb(std::as_bytes(std::span(bytes)), file.string());
}

std::size_t append_floats(GlbDocument& glb, std::span<const float> values, const char* type,
                          std::size_t count, const Json& extra) {
  glb.binary.resize((glb.binary.size() + 3) / 4 * 4);
  const std::size_t offset = glb.binary.size();
  const auto bytes = std::as_bytes(values);
  glb.binary.insert(glb.binary.end(), bytes.begin(), bytes.end());
  Json& json = glb.json;
  try {
    for (const char* list : {"buffers", "bufferViews", "accessors"}) {
      if (!json.contains(list)) {
        json[list] = Json::array();
      }
      if (!json.at(list).is_array()) {
        throw std::runtime_error(fmt::format("its {} are no list", list));
      }
    }
    if (json["buffers"].empty()) {
      json["buffers"].push_back(Json::object());
    }
    json["buffers"].at(0)["byteLength"] = glb.binary.size();
    json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", offset}, {"byteLength", bytes.size()}});
    Json accessor = {{"bufferView", json["bufferViews"].size() - 1},
                     {"componentType", kFloat},
                     {"count", count},
                     {"type", type}};
    accessor.update(extra);
    json["accessors"].push_back(std::move(accessor));
    return json["accessors"].size() - 1;
  } catch (const std::exception& error) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("the avatar: {}", error.what()));
  }
}

void write_glb(const GlbDocument& glb, const std::filesystem::path& file) {
  std::string text;
  try {
    text = glb.json.dump();
  } catch (const std::exception& error) {  // a name that is no UTF-8
    throw Error(ErrorKind::UnreadableInput, fmt::format("the avatar: {}", error.what()));
  }
  text.resize((text.size() + 3) / 4 * 4, ' ');
  const std::size_t padded = (glb.binary.size() + 3) / 4 * 4;
  const std::uint64_t total = kHeadBytes + kChunkHeadBytes + text.size() + kChunkHeadBytes + padded;
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' would be larger than a GLB can be: choose fewer frames", file.string()));
  }
  const std::uint32_t head[5] = {kMagic, 2, static_cast<std::uint32_t>(total),
                                 static_cast<std::uint32_t>(text.size()), kJsonChunk};
  const std::uint32_t binary_head[2] = {static_cast<std::uint32_t>(padded), kBinaryChunk};
  const std::byte padding[4] = {};
  files::OutputFile out(file);
  out.write(std::as_bytes(std::span(head)));
  out.write(text);
  out.write(std::as_bytes(std::span(binary_head)));
  out.write(std::span<const std::byte>(glb.binary));
  out.write(std::span(padding).first(padded - glb.binary.size()));
  out.commit();
}

}  // namespace facet::avatar
