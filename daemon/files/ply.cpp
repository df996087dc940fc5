#include "files/ply.hpp"

#include <fmt/format.h>

#include <bit>

#include "facet/assert.hpp"
#include "files/output_file.hpp"

namespace facet::files {

static_assert(std::endian::native == std::endian::little, "PLY files are written in memory order");

void write_ply(const PlyMesh& mesh, const std::filesystem::path& file) {
  std::string header = "ply\nformat binary_little_endian 1.0\n";
  for (const std::string& comment : mesh.comments) {
    header += fmt::format("comment {}\n", comment);
  }
  header += fmt::format("element vertex {}\n", mesh.vertex_count);
  std::size_t vertex_bytes = 0;
  for (const std::string& field : mesh.fields) {
    header += fmt::format("property {}\n", field);
    vertex_bytes += field.starts_with("uchar ") ? 1 : sizeof(float);
  }
  FACET_ASSERT(mesh.vertices.size() == mesh.vertex_count * vertex_bytes, mesh.vertices.size(),
               mesh.vertex_count, vertex_bytes);
  std::vector<PlyFace> faces(mesh.corners.size() / 3);
  header +=
      fmt::format("element face {}\nproperty list uchar int vertex_indices\nend_header\n", faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    faces[f] = {3, {mesh.corners[3 * f], mesh.corners[3 * f + 1], mesh.corners[3 * f + 2]}};
  }
  OutputFile output(file);
  output.write(header);
  output.write(mesh.vertices);
  output.write(std::as_bytes(std::span(faces)));
  output.commit();
}

}  // namespace facet::files
