#include "exports/export_sequence.hpp"
#include "exports/glb_file.hpp"

namespace facet::exports {

void write_glb(const ExportMesh& mesh, const std::filesystem::path& file) {
  GlbFile glb(file);
  const auto count = static_cast<std::size_t>(mesh.vertices_mm.cols());
  GltfJson attributes;
  attributes["POSITION"] = glb.add_positions(factors_of(MeshAxes::Upright).asDiagonal() * mesh.vertices_mm);
  add_attributes(attributes, glb, mesh, upright_axes().asDiagonal() * mesh.normals);
  attributes["_DISPLACEMENT_MM"] = glb.add_floats(mesh.displacements_mm, "SCALAR", count, kGltfVertices);
  attributes["_CONFIDENCE"] = glb.add_floats(mesh.confidence, "SCALAR", count, kGltfVertices);
  GltfJson primitive;
  primitive["attributes"] = std::move(attributes);
  primitive["indices"] = glb.add_triangles(mesh.triangles);
  primitive["material"] = 0;

  GltfJson document;
  document["scene"] = 0;
  document["scenes"] = GltfJson::array({{{"nodes", {0}}}});
  document["nodes"] = GltfJson::array({{{"name", "face"}, {"mesh", 0}}});
  document["meshes"] = GltfJson::array({{{"name", "face"}, {"primitives", GltfJson::array({primitive})}}});
  add_materials(document, glb, mesh, false);
  glb.commit(std::move(document));
}

}  // namespace facet::exports
