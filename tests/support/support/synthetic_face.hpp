#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "facet/frame.hpp"
#include "mesh/hierarchy.hpp"

/// A surface of which everything is known: a smooth cap the size of a face (what a tracker would know), the
/// same cap with bumps and wrinkles along its normals (the truth), skin, light, and a picture of it.
namespace facet::refine::synthetic {

struct Scene {
  int image_width_px = 400;
  int image_height_px = 480;
  float distance_mm = 600;
  float quad_mm = 4.5F;    ///< edge of the control mesh's quads
  float bump_scale = 1;    ///< times the true displacement
  bool marks = false;      ///< brows and moles in the albedo
  bool highlight = false;  ///< a glossy spot that is no diffuse light
  float noise = 0;         ///< standard deviation of the pixels, 8-bit sRGB counts
  unsigned seed = 1;
  std::array<float, 9> lighting{0.55F, 0.34F, 0.22F, 0.36F, 0.05F, -0.06F, 0.05F, -0.03F, 0.02F};
  float yaw_rad = 0;     ///< head turned about its y axis
  float bump_phase = 0;  ///< moves the wrinkles: another expression
  /// Of the camera that renders: turned about the cap, from where `camera_from_head` and the light stand.
  float camera_yaw_rad = 0;
  std::array<float, 3> exposure{1, 1, 1};  ///< RGB, linear
};

/// True displacement along the cap's normal at its point (x, y), mm.
float displacement_mm(const Scene& scene, float x_mm, float y_mm);
/// True albedo, linear RGB.
Eigen::Vector3f albedo(const Scene& scene, float x_mm, float y_mm);
/// Point of the cap and of the displaced cap, head frame, and its unit normal.
Eigen::Vector3f cap_point(float x_mm, float y_mm);
Eigen::Vector3f cap_normal(float x_mm, float y_mm);
Eigen::Vector3f true_point(const Scene& scene, float x_mm, float y_mm);
Eigen::Vector3f true_normal(const Scene& scene, float x_mm, float y_mm);

/// Control mesh of the cap: its vertices lie on it above a regular grid.
struct Cap {
  mesh::ControlMesh control;
  mesh::Vertices vertices_mm;  ///< head frame
  mesh::Vertices mean_albedo;  ///< one skin colour
};
Cap make_cap(const Scene& scene);

CameraIntrinsics camera(const Scene& scene);
Eigen::Isometry3f camera_from_head(const Scene& scene);

/// Of the camera that renders, from the one that looks straight at the cap.
Eigen::Isometry3f view_from_reference(const Scene& scene);

/// The hierarchy of the cap as the first frame sees it.
std::shared_ptr<const mesh::Hierarchy> hierarchy(const Scene& scene, const Cap& cap,
                                                 const mesh::HierarchyOptions& options);

/// Pinhole projection of a point in the camera frame.
Eigen::Vector2f project(const CameraIntrinsics& camera, const Eigen::Vector3f& point_mm);

/// The true surface seen by the camera, drawn by a scalar z-buffer from 0.5 mm triangles; black elsewhere.
Frame render(const Scene& scene);

/// (l . SH(n)) of [MD19 eq. 1] with the normal in the shading frame.
float shade(const std::array<float, 9>& lighting, const Eigen::Vector3f& normal);

/// Sum of normal angles between the vertices of a refined mesh and the truth, over vertices at least
/// margin_mm inside the cap's rim, and the mean distance along the true normal.
struct Errors {
  double normal_deg = 0;
  double distance_mm = 0;
};
/// vertices_mm and normals [3][n] in the head frame; cap_xy_mm [2][n] the vertices' own point (x, y) on the
/// cap.
Errors compare(const Scene& scene, const Eigen::Matrix3Xf& vertices_mm, const Eigen::Matrix3Xf& normals,
               const Eigen::Matrix2Xf& cap_xy_mm, float margin_mm);

}  // namespace facet::refine::synthetic
