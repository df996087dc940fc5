#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <vector>

#include "capture/depth_map.hpp"
#include "fit/template_fitter.hpp"
#include "render/renderer.hpp"
#include "support/synthetic_model.hpp"

namespace facet::fit::scene {

using capture::DepthMap;
using capture::Lens;
using Eigen::Vector3d;
using Eigen::Vector3f;

/// A template that looks along z at cameras 900 mm away.
inline const std::shared_ptr<const TemplateMesh>& surface() {
  static const auto made = std::make_shared<const TemplateMesh>(make_template(test::synthetic_model(), 3000));
  return made;
}

inline Lens lens_at(double angle_rad) {
  Lens lens;
  lens.width_px = 320;
  lens.height_px = 320;
  lens.fx_px = lens.fy_px = 1000;
  lens.cx_px = lens.cy_px = 159.5;
  Eigen::Matrix3d upright;  // looks along -z, y down
  upright << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  lens.camera_from_rig = Eigen::Translation3d(0, 0, 900) * Eigen::Isometry3d(Eigen::Quaterniond(upright)) *
                         Eigen::AngleAxisd(angle_rad, Vector3d::UnitY());
  return lens;
}

inline DepthMap depth_of(const mesh::Vertices& vertices_mm, const Lens& lens,
                         const mesh::Triangles& triangles = surface()->triangles) {
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * vertices_mm).colwise() + camera_from_rig.translation();
  const render::Raycaster caster(seen, triangles);
  DepthMap map;
  map.width_px = lens.width_px;
  map.height_px = lens.height_px;
  map.lens = lens;
  map.depth_mm = caster
                     .cast({static_cast<float>(lens.fx_px), static_cast<float>(lens.fy_px),
                            static_cast<float>(lens.cx_px), static_cast<float>(lens.cy_px), lens.width_px,
                            lens.height_px})
                     .depth_mm;
  map.sigma_mm.assign(map.depth_mm.size(), 0.1F);
  for (const float depth : map.depth_mm) {
    map.confidence.push_back(depth > 0 ? 1.0F : 0.0F);
  }
  return map;
}

inline std::vector<DepthMap> depths_of(const mesh::Vertices& vertices_mm) {
  return {depth_of(vertices_mm, lens_at(-0.35)), depth_of(vertices_mm, lens_at(0.35))};
}

/// The neutral template with a swollen cheek and a tilt.
inline mesh::Vertices swollen() {
  mesh::Vertices vertices_mm = surface()->neutral_mm;
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f at = vertices_mm.col(v);
    vertices_mm(2, v) += 5 * std::exp(-((at.x() - 30) * (at.x() - 30) + (at.y() + 25) * (at.y() + 25)) / 450);
  }
  const Eigen::AngleAxisf tilt(0.05F, Vector3f(0.3F, 1, 0).normalized());
  return (tilt.toRotationMatrix() * vertices_mm).colwise() + Vector3f(2, -1, 4);
}

inline RestShape rest() {
  return {surface()->neutral_mm, surface()->expressions_mm};
}

}  // namespace facet::fit::scene
