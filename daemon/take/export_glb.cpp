#include <bit>
#include <cstdint>
#include <cstring>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "files/output_file.hpp"
#include "take/export.hpp"

namespace facet::take {
namespace {

using Json = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little);

// Numbers of the glTF 2.0 specification.
constexpr std::uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinaryChunk = 0x004E4942;
constexpr int kComponentFloat = 5126;
constexpr int kComponentUint32 = 5125;
constexpr int kTargetVertices = 34962;
constexpr int kTargetIndices = 34963;
constexpr float kMetresPerMillimetre = 0.001F;

/// Gathers accessors and their bytes. Every element is a multiple of four bytes, so all stays aligned.
class BufferWriter {
 public:
  template <typename T>
  int add(std::span<const T> values, const char* type, int component_type, std::size_t count, int target,
          const Json& extra = Json::object()) {
    const std::size_t offset = bytes_.size();
    const auto raw = std::as_bytes(values);
    bytes_.resize(offset + raw.size());
    std::memcpy(bytes_.data() + offset, raw.data(), raw.size());
    views_.push_back({{"buffer", 0}, {"byteOffset", offset}, {"byteLength", raw.size()}, {"target", target}});
    Json accessor{{"bufferView", views_.size() - 1},
                  {"componentType", component_type},
                  {"count", count},
                  {"type", type}};
    accessor.update(extra);
    accessors_.push_back(std::move(accessor));
    return static_cast<int>(accessors_.size()) - 1;
  }
  int add_floats(std::span<const float> values, const char* type, std::size_t count,
                 const Json& extra = Json::object()) {
    return add(values, type, kComponentFloat, count, kTargetVertices, extra);
  }

  const Json& views() const { return views_; }
  const Json& accessors() const { return accessors_; }
  const std::vector<std::byte>& bytes() const { return bytes_; }

 private:
  Json views_ = Json::array();
  Json accessors_ = Json::array();
  std::vector<std::byte> bytes_;
};

std::span<const float> flat(const Eigen::Ref<const Eigen::MatrixXf>& matrix) {
  return {matrix.data(), static_cast<std::size_t>(matrix.size())};
}

Json to_list(const Eigen::Vector3f& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

/// Camera frame x right, y down -> glTF y up, +z towards the viewer.
Eigen::Vector3f gltf_axes() {
  return {1.0F, -1.0F, -1.0F};
}

Json attributes(const ExportMesh& mesh, BufferWriter& buffer) {
  const auto count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  const mesh::Vertices positions = (gltf_axes() * kMetresPerMillimetre).asDiagonal() * mesh.vertices_mm;
  const Eigen::Matrix3Xf normals = gltf_axes().asDiagonal() * mesh.normals;
  // glTF's v runs downwards.
  mesh::TextureCoordinates coordinates = mesh.texture_coordinates;
  coordinates.row(1) = 1.0F - coordinates.row(1).array();

  Json out;
  out["POSITION"] = buffer.add_floats(
      flat(positions), "VEC3", count,
      {{"min", to_list(positions.rowwise().minCoeff())}, {"max", to_list(positions.rowwise().maxCoeff())}});
  out["NORMAL"] = buffer.add_floats(flat(normals), "VEC3", count);
  out["TEXCOORD_0"] = buffer.add_floats(flat(coordinates), "VEC2", count);
  if (mesh.albedo.cols() > 0) {
    const mesh::Vertices colour = mesh.albedo.cwiseMax(0.0F).cwiseMin(1.0F);
    out["COLOR_0"] = buffer.add_floats(flat(colour), "VEC3", count);
  }
  out["_DISPLACEMENT_MM"] = buffer.add_floats(mesh.displacements_mm, "SCALAR", count);
  out["_CONFIDENCE"] = buffer.add_floats(mesh.confidence, "SCALAR", count);
  return out;
}

void append_chunk(std::vector<std::byte>& file, std::uint32_t type, std::span<const std::byte> content,
                  char padding) {
  const std::size_t padded = (content.size() + 3) / 4 * 4;
  const std::uint32_t header[2] = {static_cast<std::uint32_t>(padded), type};
  const auto header_bytes = std::as_bytes(std::span(header));
  file.insert(file.end(), header_bytes.begin(), header_bytes.end());
  file.insert(file.end(), content.begin(), content.end());
  file.insert(file.end(), padded - content.size(), static_cast<std::byte>(padding));
}

}  // namespace

void write_glb(const ExportMesh& mesh, const std::filesystem::path& file) {
  BufferWriter buffer;
  Json primitive;
  primitive["attributes"] = attributes(mesh, buffer);
  const std::span<const std::int32_t> indices(mesh.triangles.data(),
                                              static_cast<std::size_t>(mesh.triangles.size()));
  primitive["indices"] = buffer.add(indices, "SCALAR", kComponentUint32, indices.size(), kTargetIndices);
  primitive["material"] = 0;

  Json document;
  document["asset"] = {{"version", "2.0"}, {"generator", "Facet"}};
  document["scene"] = 0;
  document["scenes"] = Json::array({{{"nodes", {0}}}});
  document["nodes"] = Json::array({{{"name", "face"}, {"mesh", 0}}});
  document["meshes"] = Json::array({{{"name", "face"}, {"primitives", Json::array({primitive})}}});
  document["materials"] = Json::array(
      {{{"name", "skin"}, {"pbrMetallicRoughness", {{"metallicFactor", 0.0}, {"roughnessFactor", 0.6}}}}});
  document["accessors"] = buffer.accessors();
  document["bufferViews"] = buffer.views();
  document["buffers"] = Json::array({{{"byteLength", buffer.bytes().size()}}});
  const std::string json = document.dump();

  std::vector<std::byte> content;
  append_chunk(content, kJsonChunk, std::as_bytes(std::span(json)), ' ');
  append_chunk(content, kBinaryChunk, buffer.bytes(), '\0');
  const std::uint32_t header[3] = {kMagic, 2, static_cast<std::uint32_t>(sizeof(header) + content.size())};
  files::OutputFile out(file);
  out.write(std::as_bytes(std::span(header)));
  out.write(content);
  out.commit();
}

}  // namespace facet::take
