#include "simulation/truth_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string_view>

#include "facet/error.hpp"
#include "files/ply.hpp"
#include "files/text_file.hpp"
#include "render/renderer.hpp"

namespace facet::simulation {
namespace {

// Plain arrays: a call of a std::array's member would take the packed array for an aligned one.
#pragma pack(push, 1)
struct PlyVertex {
  float position[3];
  float normal[3];
  float albedo[3];
  std::uint8_t srgb[3];
};
#pragma pack(pop)
static_assert(sizeof(PlyVertex) == 39);

[[noreturn]] void refuse(const std::string& source, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: not a truth mesh: {}", source, why));
}

/// The named numbers of every vertex; false where the file lacks one.
bool read_fields(const files::PlySurface& surface, const std::array<const char*, 3>& names,
                 Eigen::Matrix3Xf& values) {
  const std::array fields{surface.find(names[0]), surface.find(names[1]), surface.find(names[2])};
  if (std::count(fields.begin(), fields.end(), nullptr) > 0) {
    return false;
  }
  const auto count = static_cast<Eigen::Index>(surface.vertex_count);
  values.resize(3, count);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    values.row(static_cast<Eigen::Index>(axis)) =
        Eigen::Map<const Eigen::RowVectorXf>(fields[axis]->data(), count);
  }
  return true;
}

/// The file's normals, of length 1; false where it has none, or not of every vertex.
bool read_normals(const files::PlySurface& surface, Eigen::Matrix3Xf& normals) {
  constexpr float kNearlyOne = 1e-3F;
  if (!read_fields(surface, {"nx", "ny", "nz"}, normals)) {
    return false;
  }
  for (Eigen::Index v = 0; v < normals.cols(); ++v) {
    const float length = normals.col(v).norm();
    if (!std::isfinite(length) || length == 0) {
      return false;
    }
    if (std::abs(length - 1) > kNearlyOne) {
      normals.col(v) /= length;
    }
  }
  return true;
}

}  // namespace

void write_truth_ply(const TruthMesh& mesh, const std::filesystem::path& file, std::string_view frame) {
  std::vector<PlyVertex> vertices(static_cast<std::size_t>(mesh.vertices_mm.cols()));
  for (std::size_t v = 0; v < vertices.size(); ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      const auto k = static_cast<std::size_t>(axis);
      vertices[v].position[k] = mesh.vertices_mm(axis, column);
      vertices[v].normal[k] = mesh.normals(axis, column);
      vertices[v].albedo[k] = mesh.albedo(axis, column);
      vertices[v].srgb[k] = render::linear_to_srgb8(mesh.albedo(axis, column));
    }
  }
  files::write_ply(
      {.comments = {fmt::format("Facet truth mesh: {}; albedo linear, colours sRGB", frame)},
       .fields = {"float x", "float y", "float z", "float nx", "float ny", "float nz", "float albedo_red",
                  "float albedo_green", "float albedo_blue", "uchar red", "uchar green", "uchar blue"},
       .vertices = std::as_bytes(std::span(vertices)),
       .vertex_count = vertices.size(),
       .corners = {mesh.triangles.data(), static_cast<std::size_t>(mesh.triangles.size())}},
      file);
}

TruthMesh read_truth_ply(const std::filesystem::path& file) {
  constexpr std::size_t kMostBytes = std::size_t{4} << 30U;
  return parse_truth_ply(files::read_bytes(file, kMostBytes, "truth mesh"), file.string());
}

TruthMesh parse_truth_ply(std::span<const std::byte> bytes, const std::string& source) {
  const files::PlySurface surface = files::parse_ply(bytes, source);
  TruthMesh mesh;
  if (!read_fields(surface, {"x", "y", "z"}, mesh.vertices_mm)) {
    refuse(source, "its vertices lack x, y and z");
  }
  if (!mesh.vertices_mm.allFinite()) {
    refuse(source, "a position is not finite");
  }
  if (surface.corners.empty()) {
    refuse(source, "it has no faces, and points alone are no surface: mesh them first");
  }
  mesh.triangles = Eigen::Map<const mesh::Triangles>(surface.corners.data(), 3,
                                                     static_cast<Eigen::Index>(surface.corners.size() / 3));
  if (!read_normals(surface, mesh.normals)) {
    mesh::vertex_normals(mesh.vertices_mm, mesh.triangles, mesh.normals);
  }
  if (!read_fields(surface, {"albedo_red", "albedo_green", "albedo_blue"}, mesh.albedo)) {
    constexpr float kGrey = 0.5F;
    mesh.albedo = Eigen::Matrix3Xf::Constant(3, mesh.vertices_mm.cols(), kGrey);
  }
  if (!mesh.normals.allFinite() || !mesh.albedo.allFinite()) {
    refuse(source, "a normal or an albedo is not finite");
  }
  return mesh;
}

}  // namespace facet::simulation
