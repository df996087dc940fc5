#include <fmt/format.h>

#include <iterator>

#include "exports/export.hpp"
#include "files/output_file.hpp"

namespace facet::exports {

void write_obj(const ExportMesh& mesh, const std::filesystem::path& file, std::string_view comment) {
  fmt::memory_buffer text;
  const auto out = std::back_inserter(text);
  fmt::format_to(out, "# {}\n{}", comment, mesh.albedo.cols() > 0 ? "# v x y z r g b: linear albedo\n" : "");
  for (Eigen::Index i = 0; i < mesh.vertices_mm.cols(); ++i) {
    const auto position = mesh.vertices_mm.col(i);
    fmt::format_to(out, "v {:.8g} {:.8g} {:.8g}", position.x(), position.y(), position.z());
    if (mesh.albedo.cols() > 0) {
      const auto rgb = mesh.albedo.col(i);
      fmt::format_to(out, " {:.4f} {:.4f} {:.4f}", rgb.x(), rgb.y(), rgb.z());
    }
    fmt::format_to(out, "\n");
  }
  for (Eigen::Index i = 0; i < mesh.texture_coordinates.cols(); ++i) {
    fmt::format_to(out, "vt {:.6f} {:.6f}\n", mesh.texture_coordinates(0, i), mesh.texture_coordinates(1, i));
  }
  for (Eigen::Index i = 0; i < mesh.normals.cols(); ++i) {
    fmt::format_to(out, "vn {:.5f} {:.5f} {:.5f}\n", mesh.normals(0, i), mesh.normals(1, i),
                   mesh.normals(2, i));
  }
  for (Eigen::Index i = 0; i < mesh.triangles.cols(); ++i) {
    const Eigen::Vector3i corner = mesh.triangles.col(i).array() + 1;  // OBJ counts from 1
    fmt::format_to(out, "f {0}/{0}/{0} {1}/{1}/{1} {2}/{2}/{2}\n", corner.x(), corner.y(), corner.z());
  }
  files::OutputFile output(file);
  output.write(std::string_view(text.data(), text.size()));
  output.commit();
}

}  // namespace facet::exports
