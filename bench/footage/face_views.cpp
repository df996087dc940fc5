#include "footage/face_views.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>

#include "report/take_pictures.hpp"

namespace facet::footage {
namespace {

using render::Picture;
using report::Cell;

/// The picture where the surface covers it, the background elsewhere.
Picture covered_part(const Picture& picture, const render::HitImage& hits, Picture background) {
  for (std::size_t pixel = 0; pixel < hits.triangle.size(); ++pixel) {
    if (hits.triangle[pixel] >= 0) {
      std::copy_n(&picture.rgb[3 * pixel], 3, &background.rgb[3 * pixel]);
    }
  }
  return background;
}

}  // namespace

mesh::Vertices lit_colours(const mesh::Vertices& albedo, const Eigen::Matrix3Xf& normals,
                           const std::array<float, 9>& lighting) {
  mesh::Vertices colours = albedo;
  for (Eigen::Index v = 0; v < colours.cols(); ++v) {
    colours.col(v) *= std::max(0.0F, render::irradiance(lighting, normals.col(v)));
  }
  return colours;
}

std::vector<FaceView> face_views(const mesh::MeshFrame& frame, const Frame& image, int side_px) {
  const report::FrameGeometry geometry = report::geometry_of(frame);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  const Cell cell = report::cell_around(report::face_vertices(frame), frame.camera, side_px, side_px);
  const Picture dark = render::plain_picture(side_px, side_px, report::kPaper);
  const render::Raycaster surface(geometry.refined_mm, triangles);
  const auto draw = [&](const mesh::Vertices& colours) {
    return report::render_colours(surface, triangles, colours, cell.camera, dark);
  };
  std::vector<FaceView> views;
  views.push_back({"photo", report::cell_picture(image, cell)});
  views.push_back({"cut", covered_part(views.front().picture, surface.cast(cell.camera), dark)});
  views.push_back({"grey", draw(report::grey_shading(geometry.refined_normals))});
  const Eigen::Index vertex_count = geometry.refined_mm.cols();
  if (frame.albedo && frame.albedo->linear_rgb.size() == 3 * static_cast<std::size_t>(vertex_count)) {
    const mesh::Vertices albedo =
        Eigen::Map<const mesh::Vertices>(frame.albedo->linear_rgb.data(), 3, vertex_count);
    views.push_back({"albedo", draw(albedo)});
    views.push_back({"lit", draw(lit_colours(albedo, geometry.refined_normals, frame.lighting))});
  }
  return views;
}

}  // namespace facet::footage
