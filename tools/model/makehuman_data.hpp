#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "files/text_file.hpp"
#include "mesh/mesh.hpp"
#include "render/renderer.hpp"

namespace facet::model {

/// MakeHuman's base mesh: quads with one material (a named group) each and texture coordinates per corner.
struct MakeHumanMesh {
  Eigen::Matrix3Xd vertices_dm;  ///< [3][19158], x to the subject's left, y up, z out of the face
  mesh::Quads quads;             ///< [4][18486]
  std::vector<int> group;        ///< [quad count] index into group_names
  mesh::Quads corner_uv;         ///< [4][quad count] columns of texture_coordinates
  mesh::TextureCoordinates texture_coordinates;  ///< u right, v up
  std::vector<std::string> group_names;
};

/// The mesh of vertex_count vertices in a model file's text; "file" names it in messages. Throws
/// Error(UnreadableInput) that says what is wrong.
MakeHumanMesh parse_makehuman_mesh(std::string_view text, const std::filesystem::path& file,
                                   std::size_t vertex_count);
/// Throws Error(UnreadableInput) naming the file and what is wrong in it.
MakeHumanMesh read_makehuman_mesh(const std::filesystem::path& file);

/// Row of a target in targets.bin by its name, for example "nose/nose-hump-morehump", in lower case.
using MakeHumanRows = std::map<std::string, std::size_t, std::less<>>;

/// The rows of target_count targets from the text of their list; "file" names it in messages. Throws
/// Error(UnreadableInput) that says what is wrong.
MakeHumanRows parse_makehuman_target_list(std::string_view text, const std::filesystem::path& file,
                                          std::size_t target_count);

/// The displacement targets of the package: 16-bit rows, one per target, each read when it is asked for.
class MakeHumanTargets {
 public:
  /// folder: the unpacked npm package. Throws Error(UnreadableInput) naming the file and what is wrong in it.
  explicit MakeHumanTargets(const std::filesystem::path& folder);

  bool has(std::string_view name) const { return rows_.find(name) != rows_.end(); }
  /// Names that begin with the prefix, sorted.
  std::vector<std::string> names(std::string_view prefix) const;
  /// Displacements of the chosen base mesh vertices, dm: [3][vertices.size()]. Throws Error(UnreadableInput)
  /// where there is no such target.
  Eigen::Matrix3Xd displacements_dm(std::string_view name, const std::vector<int>& vertices) const;

 private:
  std::vector<std::int16_t> row(std::size_t index) const;

  std::filesystem::path file_;
  files::InputFile values_;
  MakeHumanRows rows_;
};

/// The photographed skins (young, middle-aged and old; african, asian and caucasian; female and male),
/// without the drawn ones. Throws Error(UnreadableInput) where there are none.
std::vector<render::Picture> read_makehuman_skins(const std::filesystem::path& folder);

}  // namespace facet::model
