#include "exports/glb_file.hpp"

#include <fmt/format.h>
#include <meshoptimizer.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "facet/error.hpp"

namespace facet::exports {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::uint32_t kMagic = 0x46546C67;      // "glTF"
constexpr std::uint32_t kJsonChunk = 0x4E4F534A;  // "JSON"
constexpr std::uint32_t kBinaryChunk = 0x004E4942;
constexpr const char* kMeshopt = "EXT_meshopt_compression";

/// The extension's exponential filter: 8 bits of exponent above 24 bits of mantissa, both signed.
std::uint32_t to_fixed(float value, GltfStep step) {
  constexpr float kMost = 8388607.0F;
  const float scaled = std::clamp(std::round(std::ldexp(value, -static_cast<int>(step))), -kMost, kMost);
  const auto mantissa = static_cast<std::uint32_t>(static_cast<std::int32_t>(scaled));
  return static_cast<std::uint32_t>(step) << 24U | (mantissa & 0xFFFFFFU);
}
float from_fixed(std::uint32_t fixed) {
  const auto mantissa = static_cast<std::int32_t>(fixed << 8U) >> 8;
  return std::ldexp(static_cast<float>(mantissa), static_cast<std::int32_t>(fixed) >> 24);
}

}  // namespace

GlbFile::GlbFile(const std::filesystem::path& file, GlbCompression compression)
    : path_(file), compression_(compression), out_(file), binary_(file) {}

GltfJson GlbFile::plain_view(std::span<const std::byte> bytes) {
  GltfJson view{{"buffer", 0}, {"byteOffset", binary_.size()}, {"byteLength", bytes.size()}};
  binary_.write(bytes);
  return view;
}

GltfJson GlbFile::compressed_view(std::span<const std::byte> elements, std::size_t count, const char* mode,
                                  const char* filter) {
  const bool is_attributes = std::string_view(mode) == "ATTRIBUTES";
  const std::size_t stride = elements.size() / count;
  std::vector<unsigned char> encoded;
  if (is_attributes) {
    encoded.resize(meshopt_encodeVertexBufferBound(count, stride));
    meshopt_encodeVertexVersion(0);  // the extension's
    encoded.resize(
        meshopt_encodeVertexBuffer(encoded.data(), encoded.size(), elements.data(), count, stride));
  } else {
    const auto* indices = reinterpret_cast<const unsigned int*>(elements.data());
    encoded.resize(meshopt_encodeIndexBufferBound(count, *std::max_element(indices, indices + count) + 1));
    meshopt_encodeIndexVersion(1);
    encoded.resize(meshopt_encodeIndexBuffer(encoded.data(), encoded.size(), indices, count));
  }
  GltfJson compression{{"buffer", 0},
                       {"byteOffset", binary_.size()},
                       {"byteLength", encoded.size()},
                       {"byteStride", stride},
                       {"count", count},
                       {"mode", mode}};
  if (filter != nullptr) {
    compression["filter"] = filter;
  }
  encoded.resize((encoded.size() + 3) / 4 * 4);
  binary_.write(std::as_bytes(std::span(encoded)));
  // Buffer 1 is what the arrays would fill; it is in no file.
  GltfJson view{{"buffer", 1}, {"byteOffset", decoded_bytes_}, {"byteLength", elements.size()}};
  view["extensions"][kMeshopt] = std::move(compression);
  decoded_bytes_ += elements.size();
  return view;
}

int GlbFile::add(GltfJson view, const char* type, int component_type, std::size_t count, int target,
                 const GltfJson& extra) {
  if (target != kGltfNoTarget) {
    view["target"] = target;
  }
  views_.push_back(std::move(view));
  GltfJson accessor{
      {"bufferView", views_.size() - 1}, {"componentType", component_type}, {"count", count}, {"type", type}};
  accessor.update(extra);
  accessors_.push_back(std::move(accessor));
  return static_cast<int>(accessors_.size()) - 1;
}

int GlbFile::add_floats(std::span<const float> values, const char* type, std::size_t count, int target,
                        GltfStep step, const GltfJson& extra) {
  if (compression_ == GlbCompression::None) {
    return add(plain_view(std::as_bytes(values)), type, kGltfFloat, count, target, extra);
  }
  GltfJson view;
  if (step == GltfStep::Exact) {
    view = compressed_view(std::as_bytes(values), count, "ATTRIBUTES", nullptr);
  } else {
    std::vector<std::uint32_t> fixed(values.size());
    std::transform(values.begin(), values.end(), fixed.begin(),
                   [step](float value) { return to_fixed(value, step); });
    view = compressed_view(std::as_bytes(std::span(fixed)), count, "ATTRIBUTES", "EXPONENTIAL");
  }
  if (target == kGltfVertices) {
    view["byteStride"] = values.size_bytes() / count;
  }
  return add(std::move(view), type, kGltfFloat, count, target, extra);
}

int GlbFile::add_positions(const Eigen::Matrix3Xf& values, GltfStep step) {
  const Eigen::Matrix3Xf read = stored(values, step);
  const Eigen::Vector3f smallest = read.rowwise().minCoeff();
  const Eigen::Vector3f largest = read.rowwise().maxCoeff();
  return add_floats(flat(read), "VEC3", static_cast<std::size_t>(read.cols()), kGltfVertices, step,
                    {{"min", gltf_list(smallest)}, {"max", gltf_list(largest)}});
}

int GlbFile::add_triangles(const mesh::Triangles& triangles) {
  const std::span<const std::int32_t> indices(triangles.data(), static_cast<std::size_t>(triangles.size()));
  GltfJson view = compression_ == GlbCompression::None
                      ? plain_view(std::as_bytes(indices))
                      : compressed_view(std::as_bytes(indices), indices.size(), "TRIANGLES", nullptr);
  return add(std::move(view), "SCALAR", kGltfUint32, indices.size(), kGltfIndices, GltfJson::object());
}

int GlbFile::add_picture(std::span<const std::uint8_t> png) {
  GltfJson view = plain_view(std::as_bytes(png));
  constexpr std::array<std::byte, 3> kPadding{};
  binary_.write(std::span(kPadding).first((4 - png.size() % 4) % 4));
  views_.push_back(std::move(view));
  return static_cast<int>(views_.size()) - 1;
}

Eigen::Matrix3Xf GlbFile::stored(const Eigen::Matrix3Xf& values, GltfStep step) const {
  if (compression_ == GlbCompression::None || step == GltfStep::Exact) {
    return values;
  }
  return values.unaryExpr([step](float value) { return from_fixed(to_fixed(value, step)); });
}

void GlbFile::commit(GltfJson document) {
  document["asset"]["version"] = "2.0";
  document["asset"]["generator"] = "Facet";
  document["accessors"] = std::move(accessors_);
  document["bufferViews"] = std::move(views_);
  document["buffers"] = GltfJson::array({{{"byteLength", binary_.size()}}});
  if (compression_ == GlbCompression::Meshopt) {
    document["extensionsUsed"] = document["extensionsRequired"] = {kMeshopt};
    document["buffers"].push_back(
        {{"byteLength", decoded_bytes_}, {"extensions", {{kMeshopt, {{"fallback", true}}}}}});
  }
  std::string json = document.dump();
  json.resize((json.size() + 3) / 4 * 4, ' ');

  const std::uint64_t total = 12 + 8 + json.size() + 8 + binary_.size();
  require_glb_size(path_, total);
  const std::uint32_t head[5] = {kMagic, 2, static_cast<std::uint32_t>(total),
                                 static_cast<std::uint32_t>(json.size()), kJsonChunk};
  const std::uint32_t binary_head[2] = {static_cast<std::uint32_t>(binary_.size()), kBinaryChunk};
  out_.write(std::as_bytes(std::span(head)));
  out_.write(json);
  out_.write(std::as_bytes(std::span(binary_head)));
  binary_.move_to(out_);
  out_.commit();
}

void require_glb_size(const std::filesystem::path& file, std::uint64_t bytes, const char* of) {
  if (bytes > std::numeric_limits<std::uint32_t>::max()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format(
            "'{}' would hold {:.1f} GB{} and a GLB file can't hold more than 4.3: choose fewer frames "
            "(--frames), --level coarse, or pc2, mdd or usda-frames",
            file.string(), static_cast<double>(bytes) / 1e9, of));
  }
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

void add_materials(GltfJson& document, GlbFile& glb, const ExportMesh& mesh, bool has_eyes) {
  document["materials"] = GltfJson::array();
  for (const auto& [name, roughness] : {std::pair{"skin", 0.6}, {"eyes", 0.2}}) {
    if (name == std::string_view("eyes") && !has_eyes) {
      break;
    }
    GltfJson look{{"metallicFactor", 0.0}, {"roughnessFactor", roughness}};
    if (mesh.skin_png != nullptr) {
      look["baseColorTexture"] = {{"index", 0}};
    }
    document["materials"].push_back({{"name", name}, {"pbrMetallicRoughness", std::move(look)}});
  }
  if (mesh.skin_png != nullptr) {
    document["images"] = GltfJson::array(
        {{{"name", "albedo"}, {"bufferView", glb.add_picture(*mesh.skin_png)}, {"mimeType", "image/png"}}});
    document["samplers"] = GltfJson::array({{{"magFilter", kGltfLinear},
                                             {"minFilter", kGltfLinearMipmaps},
                                             {"wrapS", kGltfClampToEdge},
                                             {"wrapT", kGltfClampToEdge}}});
    document["textures"] = GltfJson::array({{{"sampler", 0}, {"source", 0}}});
  }
}

void add_attributes(GltfJson& attributes, GlbFile& glb, const ExportMesh& mesh,
                    const Eigen::Matrix3Xf& normals) {
  const auto count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  attributes["NORMAL"] = glb.add_floats(flat(normals), "VEC3", count, kGltfVertices, GltfStep::Normal);
  attributes["TEXCOORD_0"] = glb.add_floats(flat(gltf_texture_coordinates(mesh.texture_coordinates)), "VEC2",
                                            count, kGltfVertices, GltfStep::Texture);
  if (mesh.skin_png == nullptr && mesh.albedo.cols() > 0) {
    const mesh::Vertices colour = mesh.albedo.cwiseMax(0.0F).cwiseMin(1.0F);
    attributes["COLOR_0"] = glb.add_floats(flat(colour), "VEC3", count, kGltfVertices, GltfStep::Colour);
  }
}

mesh::TextureCoordinates gltf_texture_coordinates(const mesh::TextureCoordinates& coordinates) {
  mesh::TextureCoordinates turned = coordinates;
  turned.row(1) = 1.0F - turned.row(1).array();
  return turned;
}

}  // namespace facet::exports
