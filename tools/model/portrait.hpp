#pragma once

#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "face/face_model.hpp"
#include "render/renderer.hpp"

namespace facet::model {

/// Where a portrait is taken from: the camera looks at a point of the head frame from a distance.
struct View {
  float yaw_rad = 0;    ///< above 0: the camera moves to the subject's left
  float pitch_rad = 0;  ///< above 0: the camera moves up
  int size_px = 512;    ///< square
  float distance_mm = 900;
  float field_mm = 260;                  ///< width of what is seen at the target's distance
  Eigen::Vector3f target_mm{0, -12, 0};  ///< middle of the picture, head frame

  CameraIntrinsics camera() const;
  Eigen::Isometry3f camera_from_head() const;
};

enum class Style {
  Clay,      ///< one colour, light from above: shows the shape
  Lifelike,  ///< mean albedo with irises, pupils and brows: what the landmark net needs to see a face
};

/// Pictures of one model's faces. Any thread once built.
class PortraitRenderer {
 public:
  explicit PortraitRenderer(const face::FaceModel& model);

  /// vertices_mm [3][vertex_count] in the head frame.
  render::Picture render(const mesh::Vertices& vertices_mm, const View& view, Style style) const;

  const mesh::Triangles& triangles() const { return triangles_; }

 private:
  /// An eyeball: a connected part of the mesh that belongs wholly to the eye region.
  struct Eyeball {
    std::vector<int> vertices;
    std::vector<int> front;  ///< vertices around its pole
  };

  std::vector<Eyeball> eyeballs_;
  std::vector<int> eyeball_of_vertex_;  ///< [vertex_count] index, -1 where it is none
  mesh::Triangles triangles_;
  mesh::Vertices lifelike_albedo_;
  mesh::Vertices clay_albedo_;
  mesh::Vertices brow_;  ///< [3][vertex_count] first row: 1 in the brows, falling to 0 around them
};

/// The quads split into triangles, in the order that landmark anchors are found in.
mesh::Triangles model_triangles(const face::FaceModel& model);

}  // namespace facet::model
