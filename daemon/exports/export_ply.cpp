#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "exports/export_sequence.hpp"
#include "files/ply.hpp"
#include "maths/srgb.hpp"

namespace facet::exports {
namespace {

#pragma pack(push, 1)
struct PlyVertex {
  float x, y, z;
  float nx, ny, nz;
  float s, t;
  std::uint8_t red, green, blue;
  float displacement_mm;
  float confidence;
};
#pragma pack(pop)
static_assert(sizeof(PlyVertex) == 8 * 4 + 3 + 2 * 4);

/// Colour of a mesh whose albedo is not learned yet, sRGB.
constexpr std::uint8_t kUnknownColour = 200;

/// sRGB of a linear value, 0 to 255; values outside 0 to 1 are clamped.
std::uint8_t srgb_from_linear(float linear) {
  return static_cast<std::uint8_t>(std::lrint(maths::encode_srgb(std::clamp(linear, 0.0F, 1.0F)) * 255.0F));
}

/// sRGB colour of one vertex.
std::array<std::uint8_t, 3> vertex_colour(const ExportMesh& mesh, Eigen::Index vertex) {
  if (mesh.albedo.cols() == 0) {
    return {kUnknownColour, kUnknownColour, kUnknownColour};
  }
  const auto rgb = mesh.albedo.col(vertex);
  return {srgb_from_linear(rgb.x()), srgb_from_linear(rgb.y()), srgb_from_linear(rgb.z())};
}

}  // namespace

void write_ply(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes axes) {
  const Eigen::Vector3f factors = factors_of(axes);
  const Eigen::Vector3f turn = factors.array().sign();
  std::vector<PlyVertex> vertices(static_cast<std::size_t>(mesh.vertices_mm.cols()));
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const auto column = static_cast<Eigen::Index>(i);
    const Eigen::Vector3f position = factors.cwiseProduct(mesh.vertices_mm.col(column));
    const Eigen::Vector3f normal = turn.cwiseProduct(mesh.normals.col(column));
    const auto [red, green, blue] = vertex_colour(mesh, column);
    vertices[i] = {position.x(),
                   position.y(),
                   position.z(),
                   normal.x(),
                   normal.y(),
                   normal.z(),
                   mesh.texture_coordinates(0, column),
                   mesh.texture_coordinates(1, column),
                   red,
                   green,
                   blue,
                   mesh.displacements_mm[i],
                   mesh.confidence[i]};
  }
  const char* colour = mesh.albedo.cols() > 0 ? "albedo, sRGB" : "none, the albedo is not learned yet";
  files::write_ply(
      {.comments = {fmt::format("Facet: {}", words_of(axes)), fmt::format("colour: {}", colour)},
       .fields = {"float x", "float y", "float z", "float nx", "float ny", "float nz", "float s", "float t",
                  "uchar red", "uchar green", "uchar blue", "float displacement_mm", "float confidence"},
       .vertices = std::as_bytes(std::span(vertices)),
       .vertex_count = vertices.size(),
       .corners = {mesh.triangles.data(), static_cast<std::size_t>(mesh.triangles.size())}},
      file);
}

}  // namespace facet::exports
