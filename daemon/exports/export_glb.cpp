#include "exports/export_sequence.hpp"
#include "exports/glb_file.hpp"

namespace facet::exports {
namespace {

GltfJson attributes(const ExportMesh& mesh, GlbFile& glb) {
  const auto count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  const Eigen::Matrix3Xf normals = upright_axes().asDiagonal() * mesh.normals;
  GltfJson out;
  out["POSITION"] = glb.add_positions(factors_of(MeshAxes::Upright).asDiagonal() * mesh.vertices_mm);
  out["NORMAL"] = glb.add_floats(flat(normals), "VEC3", count, kGltfVertices);
  out["TEXCOORD_0"] =
      glb.add_floats(flat(gltf_texture_coordinates(mesh.texture_coordinates)), "VEC2", count, kGltfVertices);
  if (mesh.albedo.cols() > 0) {
    const mesh::Vertices colour = mesh.albedo.cwiseMax(0.0F).cwiseMin(1.0F);
    out["COLOR_0"] = glb.add_floats(flat(colour), "VEC3", count, kGltfVertices);
  }
  out["_DISPLACEMENT_MM"] = glb.add_floats(mesh.displacements_mm, "SCALAR", count, kGltfVertices);
  out["_CONFIDENCE"] = glb.add_floats(mesh.confidence, "SCALAR", count, kGltfVertices);
  return out;
}

}  // namespace

void write_glb(const ExportMesh& mesh, const std::filesystem::path& file) {
  GlbFile glb(file);
  GltfJson primitive;
  primitive["attributes"] = attributes(mesh, glb);
  primitive["indices"] = glb.add_triangles(mesh.triangles);
  primitive["material"] = 0;

  GltfJson document;
  document["scene"] = 0;
  document["scenes"] = GltfJson::array({{{"nodes", {0}}}});
  document["nodes"] = GltfJson::array({{{"name", "face"}, {"mesh", 0}}});
  document["meshes"] = GltfJson::array({{{"name", "face"}, {"primitives", GltfJson::array({primitive})}}});
  document["materials"] = GltfJson::array({gltf_skin()});
  glb.commit(std::move(document));
}

}  // namespace facet::exports
