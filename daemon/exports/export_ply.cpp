#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "exports/export.hpp"
#include "files/output_file.hpp"
#include "maths/srgb.hpp"

namespace facet::exports {
namespace {

// Vertices and faces are copied to the file as they lie in memory.
static_assert(std::endian::native == std::endian::little);

#pragma pack(push, 1)
struct PlyVertex {
  float x, y, z;
  float nx, ny, nz;
  float s, t;
  std::uint8_t red, green, blue;
  float displacement_mm;
  float confidence;
};

struct PlyFace {
  std::uint8_t count;
  std::int32_t vertices[3];
};
#pragma pack(pop)
static_assert(sizeof(PlyVertex) == 8 * 4 + 3 + 2 * 4);
static_assert(sizeof(PlyFace) == 1 + 3 * 4);

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

void write_ply(const ExportMesh& mesh, const std::filesystem::path& file) {
  files::OutputFile out(file);
  out.write(
      fmt::format("ply\nformat binary_little_endian 1.0\n"
                  "comment Facet: camera frame, millimetres, x right, y down, z forward\n"
                  "comment colour: {}\n"
                  "element vertex {}\n"
                  "property float x\nproperty float y\nproperty float z\n"
                  "property float nx\nproperty float ny\nproperty float nz\n"
                  "property float s\nproperty float t\n"
                  "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                  "property float displacement_mm\nproperty float confidence\n"
                  "element face {}\nproperty list uchar int vertex_indices\nend_header\n",
                  mesh.albedo.cols() > 0 ? "albedo, sRGB" : "none, the albedo is not learned yet",
                  mesh.vertices_mm.cols(), mesh.triangles.cols()));
  std::vector<PlyVertex> vertices(static_cast<std::size_t>(mesh.vertices_mm.cols()));
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const auto column = static_cast<Eigen::Index>(i);
    const auto position = mesh.vertices_mm.col(column);
    const auto normal = mesh.normals.col(column);
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
  out.write(std::as_bytes(std::span(vertices)));
  std::vector<PlyFace> faces(static_cast<std::size_t>(mesh.triangles.cols()));
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const auto corners = mesh.triangles.col(static_cast<Eigen::Index>(i));
    faces[i] = {3, {corners.x(), corners.y(), corners.z()}};
  }
  out.write(std::as_bytes(std::span(faces)));
  out.commit();
}

}  // namespace facet::exports
