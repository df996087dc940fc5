#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>

#include "files/output_file.hpp"
#include "take/export.hpp"

namespace facet::take {

using GltfJson = nlohmann::ordered_json;

// Numbers of the glTF 2.0 specification.
inline constexpr int kGltfFloat = 5126;
inline constexpr int kGltfUint32 = 5125;
inline constexpr int kGltfVertices = 34962;  ///< a buffer view's target
inline constexpr int kGltfIndices = 34963;
inline constexpr int kGltfNoTarget = 0;

/// A GLB file (glTF 2.0) that is written as its data come: accessors go to the disk at once, the document
/// that names them last. Every element is a multiple of four bytes, so all stays aligned. Errors as in
/// SequenceWriter.
class GlbFile {
 public:
  explicit GlbFile(const std::filesystem::path& file);

  /// Appends an accessor's elements; returns its index. extra: further members of the accessor.
  int add(std::span<const std::byte> bytes, const char* type, int component_type, std::size_t count,
          int target, const GltfJson& extra = GltfJson::object());
  int add_floats(std::span<const float> values, const char* type, std::size_t count, int target,
                 const GltfJson& extra = GltfJson::object());
  /// [3][count] with the smallest and largest values, which glTF wants of positions.
  int add_positions(const Eigen::Matrix3Xf& values);

  /// Adds asset, accessors, bufferViews and buffers to the document and puts the file in its place.
  void commit(GltfJson document);

  const std::filesystem::path& file() const { return path_; }

 private:
  std::filesystem::path path_;
  files::OutputFile out_;
  files::ScratchFile binary_;
  GltfJson views_ = GltfJson::array();
  GltfJson accessors_ = GltfJson::array();
};

std::span<const float> flat(const Eigen::Ref<const Eigen::MatrixXf>& matrix);
GltfJson gltf_list(const Eigen::Ref<const Eigen::VectorXf>& vector);
/// The one material of all exports.
GltfJson gltf_skin();
/// Texture coordinates as glTF has them, v downwards.
mesh::TextureCoordinates gltf_texture_coordinates(const mesh::TextureCoordinates& coordinates);

}  // namespace facet::take
