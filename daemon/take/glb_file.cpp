#include "take/glb_file.hpp"

#include <fmt/format.h>

#include <bit>
#include <limits>
#include <string>
#include <utility>

#include "facet/error.hpp"

namespace facet::take {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinaryChunk = 0x004E4942;

}  // namespace

GlbFile::GlbFile(const std::filesystem::path& file) : path_(file), out_(file), binary_(file) {}

int GlbFile::add(std::span<const std::byte> bytes, const char* type, int component_type, std::size_t count,
                 int target, const GltfJson& extra) {
  GltfJson view{{"buffer", 0}, {"byteOffset", binary_.size()}, {"byteLength", bytes.size()}};
  if (target != kGltfNoTarget) {
    view["target"] = target;
  }
  binary_.write(bytes);
  views_.push_back(std::move(view));
  GltfJson accessor{
      {"bufferView", views_.size() - 1}, {"componentType", component_type}, {"count", count}, {"type", type}};
  accessor.update(extra);
  accessors_.push_back(std::move(accessor));
  return static_cast<int>(accessors_.size()) - 1;
}

int GlbFile::add_floats(std::span<const float> values, const char* type, std::size_t count, int target,
                        const GltfJson& extra) {
  return add(std::as_bytes(values), type, kGltfFloat, count, target, extra);
}

int GlbFile::add_positions(const Eigen::Matrix3Xf& values) {
  const Eigen::Vector3f smallest = values.rowwise().minCoeff();
  const Eigen::Vector3f largest = values.rowwise().maxCoeff();
  return add_floats(flat(values), "VEC3", static_cast<std::size_t>(values.cols()), kGltfVertices,
                    {{"min", gltf_list(smallest)}, {"max", gltf_list(largest)}});
}

void GlbFile::commit(GltfJson document) {
  document["asset"] = {{"version", "2.0"}, {"generator", "Facet"}};
  document["accessors"] = std::move(accessors_);
  document["bufferViews"] = std::move(views_);
  document["buffers"] = GltfJson::array({{{"byteLength", binary_.size()}}});
  std::string json = document.dump();
  json.resize((json.size() + 3) / 4 * 4, ' ');

  const std::uint64_t total = 12 + 8 + json.size() + 8 + binary_.size();
  if (total > std::numeric_limits<std::uint32_t>::max()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("'{}' would be {:.1f} GB and a GLB file can't be larger than 4.3: choose fewer frames "
                    "(--frames), --level coarse, or pc2, mdd or usda",
                    path_.string(), static_cast<double>(total) / 1e9));
  }
  const std::uint32_t head[5] = {kMagic, 2, static_cast<std::uint32_t>(total),
                                 static_cast<std::uint32_t>(json.size()), kJsonChunk};
  const std::uint32_t binary_head[2] = {static_cast<std::uint32_t>(binary_.size()), kBinaryChunk};
  out_.write(std::as_bytes(std::span(head)));
  out_.write(json);
  out_.write(std::as_bytes(std::span(binary_head)));
  binary_.move_to(out_);
  out_.commit();
}

std::span<const float> flat(const Eigen::Ref<const Eigen::MatrixXf>& matrix) {
  return {matrix.data(), static_cast<std::size_t>(matrix.size())};
}

GltfJson gltf_list(const Eigen::Ref<const Eigen::VectorXf>& vector) {
  GltfJson list = GltfJson::array();
  for (const float value : vector) {
    list.push_back(value);
  }
  return list;
}

GltfJson gltf_skin() {
  return {{"name", "skin"}, {"pbrMetallicRoughness", {{"metallicFactor", 0.0}, {"roughnessFactor", 0.6}}}};
}

mesh::TextureCoordinates gltf_texture_coordinates(const mesh::TextureCoordinates& coordinates) {
  mesh::TextureCoordinates turned = coordinates;
  turned.row(1) = 1.0F - turned.row(1).array();
  return turned;
}

}  // namespace facet::take
