#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "exports/export_sequence.hpp"
#include "files/output_file.hpp"
#include "maths/srgb.hpp"

namespace facet::exports {

void write_obj(const ExportMesh& mesh, const std::filesystem::path& file, MeshAxes axes) {
  if (axes == MeshAxes::Camera) {
    write_obj_as_is(mesh, file, words_of(axes));
    return;
  }
  ExportMesh upright = mesh;
  upright.vertices_mm = factors_of(axes).asDiagonal() * mesh.vertices_mm;
  upright.normals = upright_axes().asDiagonal() * mesh.normals;
  write_obj_as_is(upright, file, words_of(axes));
}

void write_obj_as_is(const ExportMesh& mesh, const std::filesystem::path& file, std::string_view words) {
  fmt::memory_buffer text;
  const auto out = std::back_inserter(text);
  fmt::format_to(out, "# Facet: {}\n{}", words,
                 mesh.albedo.cols() > 0 ? "# v x y z r g b: albedo, sRGB\n" : "");
  for (Eigen::Index i = 0; i < mesh.vertices_mm.cols(); ++i) {
    const auto position = mesh.vertices_mm.col(i);
    fmt::format_to(out, "v {:.8g} {:.8g} {:.8g}", position.x(), position.y(), position.z());
    if (mesh.albedo.cols() > 0) {
      const Eigen::Vector3f rgb = mesh.albedo.col(i).unaryExpr(
          [](float linear) { return maths::encode_srgb(std::clamp(linear, 0.0F, 1.0F)); });
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
