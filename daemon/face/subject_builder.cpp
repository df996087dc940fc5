#include "face/subject_builder.hpp"

#include <algorithm>
#include <limits>
#include <utility>

#include "mesh/quads.hpp"

namespace facet::face {
namespace {

/// Nearer than this a projection means nothing.
constexpr float kNearest_mm = 1.0F;

}  // namespace

mesh::TextureCoordinates project(const mesh::Vertices& vertices_mm, const Eigen::Isometry3f& camera_from_head,
                                 const CameraIntrinsics& camera) {
  mesh::TextureCoordinates projected_px(2, vertices_mm.cols());
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Eigen::Vector3f p = camera_from_head * vertices_mm.col(v);
    if (p.z() > kNearest_mm) {
      projected_px.col(v) << camera.fx * p.x() / p.z() + camera.cx, camera.fy * p.y() / p.z() + camera.cy;
    } else {
      projected_px.col(v).setConstant(std::numeric_limits<float>::quiet_NaN());
    }
  }
  return projected_px;
}

std::vector<std::uint8_t> facing_camera(const mesh::Quads& quads, const mesh::Vertices& vertices_mm,
                                        const Eigen::Isometry3f& camera_from_head) {
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, mesh::split_quads(quads), normals);
  const Eigen::Vector3f camera_in_head = camera_from_head.inverse().translation();
  std::vector<std::uint8_t> facing(static_cast<std::size_t>(vertices_mm.cols()));
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    facing[static_cast<std::size_t>(v)] = normals.col(v).dot(camera_in_head - vertices_mm.col(v)) > 0 ? 1 : 0;
  }
  return facing;
}

std::shared_ptr<const mesh::Subject> build_subject(const FaceModel& model,
                                                   const mesh::HierarchyOptions& options,
                                                   const mesh::MeshFrame& first_good,
                                                   const std::vector<float>& identity, std::uint32_t count,
                                                   const std::string& person) {
  const mesh::Vertices& vertices_mm = first_good.control_vertices_mm;
  auto subject = std::make_shared<mesh::Subject>();
  subject->hierarchy = mesh::build_hierarchy(
      model.control, project(vertices_mm, first_good.camera_from_head, first_good.camera),
      facing_camera(model.control.quads, vertices_mm, first_good.camera_from_head), options);
  subject->expression_names = model.expression_names;
  subject->identity = identity;
  if (model.identity_count() == 0) {  // a person's own
    subject->identity = model.carried_from;
    subject->neutral_mm = model.core_row(0, 0);
  }
  subject->regions = model.regions;
  subject->person = person;
  subject->id = mesh::subject_id(*subject, count);
  return subject;
}

KnownSkin known_skin(const FaceModel& model, const mesh::Hierarchy& hierarchy) {
  if (model.skin.empty()) {
    return {};
  }
  std::vector<mesh::Vertices> mean_albedo;
  mesh::push_positions(hierarchy, model.mean_albedo, mean_albedo);
  return {relief_at(model.skin, hierarchy.texture_coordinates),
          albedo_at(model.skin, hierarchy.texture_coordinates, mean_albedo.back())};
}

}  // namespace facet::face
