#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>

#include "exports/export.hpp"
#include "files/output_file.hpp"

namespace facet::exports {

using GltfJson = nlohmann::ordered_json;

// Numbers of the glTF 2.0 specification.
inline constexpr int kGltfFloat = 5126;
inline constexpr int kGltfUint32 = 5125;
inline constexpr int kGltfVertices = 34962;  ///< a buffer view's target
inline constexpr int kGltfIndices = 34963;
inline constexpr int kGltfNoTarget = 0;
inline constexpr int kGltfLinear = 9729;
inline constexpr int kGltfLinearMipmaps = 9987;
inline constexpr int kGltfClampToEdge = 33071;

/// What a compressed file rounds values to, as a power of two; an uncompressed one keeps floats as they are.
enum class GltfStep : int {
  Exact = 0,       ///< nothing is rounded
  Position = -19,  ///< m: at most 0.001 mm away along an axis
  Shape = -23,     ///< positions of shapes that add up, m
  Normal = -10,    ///< at most 0.05 degrees away
  Texture = -18,   ///< of the picture's side
  Colour = -15,
};

/// A GLB file (glTF 2.0) that is written as its data come: accessors go to the disk at once, the document
/// that names them last. Every element is a multiple of four bytes, so all stays aligned. Errors as in
/// SequenceWriter.
///
/// Compressed (GlbCompression::Meshopt) every array is encoded by EXT_meshopt_compression, which the document
/// then requires: floats as fixed-point numbers through the extension's exponential filter, so that a reader
/// gets floats all the same; vertices and triangles keep their order, a triangle may begin at another corner.
class GlbFile {
 public:
  explicit GlbFile(const std::filesystem::path& file, GlbCompression compression = GlbCompression::None);

  /// Appends an accessor's elements; returns its index. extra: further members of the accessor.
  int add_floats(std::span<const float> values, const char* type, std::size_t count, int target,
                 GltfStep step = GltfStep::Exact, const GltfJson& extra = GltfJson::object());
  /// [3][count] with the smallest and largest values, which glTF wants of positions.
  int add_positions(const Eigen::Matrix3Xf& values, GltfStep step = GltfStep::Position);
  /// [3][triangle_count]
  int add_triangles(const mesh::Triangles& triangles);

  /// Appends a picture as it is; returns the index of its buffer view.
  int add_picture(std::span<const std::uint8_t> png);

  /// Values as a reader of this file will have them.
  Eigen::Matrix3Xf stored(const Eigen::Matrix3Xf& values, GltfStep step) const;

  /// Adds asset, accessors, bufferViews and buffers to the document and puts the file in its place.
  void commit(GltfJson document);

  const std::filesystem::path& file() const { return path_; }

 private:
  int add(GltfJson view, const char* type, int component_type, std::size_t count, int target,
          const GltfJson& extra);
  GltfJson plain_view(std::span<const std::byte> bytes);
  /// elements: as they are to be encoded. mode, filter: names of the extension.
  GltfJson compressed_view(std::span<const std::byte> elements, std::size_t count, const char* mode,
                           const char* filter);

  std::filesystem::path path_;
  GlbCompression compression_;
  files::OutputFile out_;
  files::ScratchFile binary_;
  GltfJson views_ = GltfJson::array();
  GltfJson accessors_ = GltfJson::array();
  std::uint64_t decoded_bytes_ = 0;  ///< of all compressed views
};

std::span<const float> flat(const Eigen::Ref<const Eigen::MatrixXf>& matrix);
/// Throws Error(Usage) where a file can't hold so many bytes, with what to do. of: of what, " of weights".
void require_glb_size(const std::filesystem::path& file, std::uint64_t bytes, const char* of = "");
GltfJson gltf_list(const Eigen::Ref<const Eigen::VectorXf>& vector);
/// Adds the materials of all exports to a document, 0 skin and 1 eyes, and the picture that they show where
/// the mesh has one. Where eyes are no mesh of their own, has_eyes is false.
void add_materials(GltfJson& document, GlbFile& glb, const ExportMesh& mesh, bool has_eyes);
/// Adds normals (as given), texture coordinates and, where the mesh has no picture, the albedo as COLOR_0 to
/// a primitive's attributes: glTF multiplies texture and COLOR_0, so a file has either.
void add_attributes(GltfJson& attributes, GlbFile& glb, const ExportMesh& mesh,
                    const Eigen::Matrix3Xf& normals);
/// Texture coordinates as glTF has them, v downwards.
mesh::TextureCoordinates gltf_texture_coordinates(const mesh::TextureCoordinates& coordinates);

}  // namespace facet::exports
