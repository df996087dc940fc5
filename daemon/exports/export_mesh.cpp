#include <algorithm>
#include <cmath>

#include "exports/export_sequence.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::exports {
namespace {

std::vector<float> leading(const std::vector<float>& values, std::size_t count) {
  std::vector<float> out(count, 0.0F);
  std::copy_n(values.begin(), std::min(values.size(), count), out.begin());
  return out;
}

}  // namespace

const char* words_of(MeshAxes axes) {
  return axes == MeshAxes::Upright ? "metres, x to the picture's right, y up, z towards the camera"
                                   : "camera frame, millimetres, x right, y down, z forward";
}

Eigen::Vector3f factors_of(MeshAxes axes) {
  return axes == MeshAxes::Upright ? Eigen::Vector3f(kMetresPerMillimetre * upright_axes())
                                   : Eigen::Vector3f::Ones();
}

void mend_normals(Eigen::Matrix3Xf& normals) {
  for (Eigen::Index column = 0; column < normals.cols(); ++column) {
    const float length = normals.col(column).norm();
    normals.col(column) =
        length > 0.5F ? Eigen::Vector3f(normals.col(column) / length) : Eigen::Vector3f(0, 0, -1);
  }
}

void build_export_mesh(const mesh::MeshFrame& frame, MeshLevel level, MeshSpace space, ExportMesh& out) {
  if (!mesh::has_mesh(frame)) {
    throw Error(ErrorKind::Internal, "export: the frame has no mesh");
  }
  const mesh::Hierarchy& hierarchy = *frame.subject->hierarchy;
  const bool finest = level == MeshLevel::Finest;
  const mesh::Level& source = finest ? hierarchy.finest() : hierarchy.levels.front();
  if (finest) {
    mesh::rebuild_finest(hierarchy, frame.control_vertices_mm, frame.displacements_mm, out.vertices_mm,
                         out.normals);
  } else {
    Eigen::MatrixXf coarse;
    mesh::apply(source.from_coarser, frame.control_vertices_mm, coarse);
    out.vertices_mm = coarse;
    mesh::vertex_normals(out.vertices_mm, source.triangles, out.normals);
  }
  if (space == MeshSpace::Camera) {
    out.vertices_mm =
        (frame.camera_from_head.linear() * out.vertices_mm).colwise() + frame.camera_from_head.translation();
    out.normals = frame.camera_from_head.linear() * out.normals;
  }
  mend_normals(out.normals);
  out.triangles = source.triangles;

  // A coarser level's vertices come first among the finest level's.
  const auto count = static_cast<std::size_t>(source.vertex_count);
  out.texture_coordinates = hierarchy.texture_coordinates.leftCols(source.vertex_count);
  out.displacements_mm = finest ? leading(frame.displacements_mm, count) : std::vector<float>(count, 0.0F);
  out.confidence = leading(frame.confidence, count);
  out.albedo.resize(3, 0);
  out.skin_png.reset();
  if (frame.albedo != nullptr && frame.albedo->linear_rgb.size() >= 3 * count) {
    out.albedo = Eigen::Map<const mesh::Vertices>(frame.albedo->linear_rgb.data(), 3, source.vertex_count);
  }
}

}  // namespace facet::exports
