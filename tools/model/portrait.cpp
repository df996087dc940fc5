#include "model/portrait.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "mesh/quads.hpp"
#include "model/head_mesh.hpp"

namespace facet::model {
namespace {

using face::Region;

constexpr float kIrisAngleRad = 0.44F;
constexpr float kPupilAngleRad = 0.19F;
constexpr float kBrowEdgeLow = 0.35F;  // of the smoothed brow region: skin below, hair above kBrowEdgeHigh
constexpr float kBrowEdgeHigh = 0.6F;
constexpr float kFrontAngleRad = 0.9F;  // of an eyeball's vertices that tell where it looks

const Eigen::Vector3f kSclera(0.62F, 0.56F, 0.53F);
const Eigen::Vector3f kIris(0.09F, 0.05F, 0.03F);
const Eigen::Vector3f kPupil(0.01F, 0.01F, 0.01F);
const Eigen::Vector3f kBrowHair(0.035F, 0.024F, 0.018F);
const Eigen::Vector3f kClay(0.55F, 0.47F, 0.42F);
const Eigen::Vector3f kClayLips(0.50F, 0.33F, 0.30F);
const Eigen::Vector3f kMouthInterior(0.16F, 0.035F, 0.03F);

// Light in the camera frame (y up, z towards the camera), [MD19 eq. 1]: soft, from above and in
// front.
constexpr std::array<float, 9> kSoftLight = {0.70F, 0.05F, 0.16F, 0.28F, 0, 0, 0, 0, 0.02F};
constexpr std::array<float, 9> kModellingLight = {0.38F, 0.20F, 0.30F, 0.34F, 0, 0, 0, 0, 0};

constexpr std::array<std::uint8_t, 3> kBackground = {118, 120, 124};

Eigen::Vector3f centroid(const mesh::Vertices& positions, const std::vector<int>& vertices) {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (const int v : vertices) {
    sum += positions.col(v);
  }
  return sum / static_cast<float>(vertices.size());
}

/// Connected parts of the mesh: the smallest vertex of its part, for every vertex.
std::vector<int> connected_parts(const mesh::Quads& quads, int vertex_count) {
  std::vector<int> part(static_cast<std::size_t>(vertex_count));
  std::iota(part.begin(), part.end(), 0);
  for (bool changed = true; changed;) {
    changed = false;
    for (Eigen::Index q = 0; q < quads.cols(); ++q) {
      int lowest = part[static_cast<std::size_t>(quads(0, q))];
      for (int corner = 1; corner < 4; ++corner) {
        lowest = std::min(lowest, part[static_cast<std::size_t>(quads(corner, q))]);
      }
      for (int corner = 0; corner < 4; ++corner) {
        int& own = part[static_cast<std::size_t>(quads(corner, q))];
        changed = changed || own != lowest;
        own = lowest;
      }
    }
  }
  return part;
}

/// The brow region smoothed once over the one-rings, so that its outline follows no single vertex.
mesh::Vertices smooth_brow(const face::FaceModel& model) {
  mesh::Vertices sum = mesh::Vertices::Zero(3, model.vertex_count());
  std::vector<int> count(model.regions.size(), 0);
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    float inside = 0;
    for (int corner = 0; corner < 4; ++corner) {
      const auto v = static_cast<std::size_t>(model.control.quads(corner, q));
      inside += face::has_region(model.regions[v], Region::Brow) ? 0.25F : 0.0F;
    }
    for (int corner = 0; corner < 4; ++corner) {
      const int v = model.control.quads(corner, q);
      sum(0, v) += inside;
      ++count[static_cast<std::size_t>(v)];
    }
  }
  for (Eigen::Index v = 0; v < sum.cols(); ++v) {
    sum.col(v) /= static_cast<float>(std::max(1, count[static_cast<std::size_t>(v)]));
  }
  return sum;
}

}  // namespace

CameraIntrinsics View::camera() const {
  const float focal_px = static_cast<float>(size_px) * distance_mm / field_mm;
  const float centre_px = 0.5F * static_cast<float>(size_px - 1);
  return {focal_px, focal_px, centre_px, centre_px, size_px, size_px};
}

Eigen::Isometry3f View::camera_from_head() const {
  Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
  // The head frame's y and z point against the camera's.
  const Eigen::Matrix3f facing = Eigen::Vector3f(1, -1, -1).asDiagonal();
  pose.linear() = facing * (Eigen::AngleAxisf(pitch_rad, Eigen::Vector3f::UnitX()) *
                            Eigen::AngleAxisf(-yaw_rad, Eigen::Vector3f::UnitY()))
                               .toRotationMatrix();
  pose.translation() = Eigen::Vector3f(0, 0, distance_mm) - pose.linear() * target_mm;
  return pose;
}

mesh::Triangles model_triangles(const face::FaceModel& model) {
  return mesh::split_quads(model.control.quads);
}

PortraitRenderer::PortraitRenderer(const face::FaceModel& model)
    : eyeball_of_vertex_(model.regions.size(), -1), triangles_(model_triangles(model)) {
  const mesh::Vertices mean_mm = model.core_row(0, 0);
  const std::vector<int> part = connected_parts(model.control.quads, model.vertex_count());
  std::vector<std::vector<int>> members(model.regions.size());
  for (std::size_t v = 0; v < part.size(); ++v) {
    members[static_cast<std::size_t>(part[v])].push_back(static_cast<int>(v));
  }
  for (const auto& vertices : members) {
    if (vertices.empty() || !std::all_of(vertices.begin(), vertices.end(), [&](int v) {
          return face::has_region(model.regions[static_cast<std::size_t>(v)], Region::Eye);
        })) {
      continue;
    }
    Eyeball eyeball{vertices, {}};
    const Eigen::Vector3f centre = centroid(mean_mm, vertices);
    for (const int v : vertices) {
      if ((mean_mm.col(v) - centre).normalized().z() > std::cos(kFrontAngleRad)) {
        eyeball.front.push_back(v);
      }
      eyeball_of_vertex_[static_cast<std::size_t>(v)] = static_cast<int>(eyeballs_.size());
    }
    eyeballs_.push_back(std::move(eyeball));
  }
  lifelike_albedo_ = model.mean_albedo;
  clay_albedo_ = kClay.replicate(1, model.vertex_count());
  brow_ = smooth_brow(model);
  for (Eigen::Index v = 0; v < model.vertex_count(); ++v) {
    const std::uint8_t bits = model.regions[static_cast<std::size_t>(v)];
    if (face::has_region(bits, Region::MouthInterior)) {
      lifelike_albedo_.col(v) = clay_albedo_.col(v) = kMouthInterior;
    }
    if (face::has_region(bits, Region::Lips)) {
      clay_albedo_.col(v) = kClayLips;
    }
  }
}

render::Picture PortraitRenderer::render(const mesh::Vertices& vertices_mm, const View& view,
                                         Style style) const {
  const Eigen::Isometry3f camera_from_head = view.camera_from_head();
  const mesh::Vertices vertices_camera_mm =
      (camera_from_head.linear() * vertices_mm).colwise() + camera_from_head.translation();
  mesh::Vertices normals;
  mesh::vertex_normals(vertices_camera_mm, triangles_, normals);

  std::vector<Eigen::Vector3f> centres;
  std::vector<Eigen::Vector3f> gazes;
  for (const Eyeball& eyeball : eyeballs_) {
    centres.push_back(centroid(vertices_camera_mm, eyeball.vertices));
    gazes.push_back(
        eyeball.front.empty()
            ? Eigen::Vector3f(0, 0, -1)
            : Eigen::Vector3f((centroid(vertices_camera_mm, eyeball.front) - centres.back()).normalized()));
  }
  const mesh::Vertices& albedo = style == Style::Lifelike ? lifelike_albedo_ : clay_albedo_;
  const auto& light = style == Style::Lifelike ? kSoftLight : kModellingLight;
  const auto colour = [&](std::int32_t triangle, const Eigen::Vector2f& barycentric) -> Eigen::Vector3f {
    const Eigen::Vector3f normal =
        render::interpolate(triangles_, triangle, barycentric, normals).normalized();
    Eigen::Vector3f surface = render::interpolate(triangles_, triangle, barycentric, albedo);
    const int eyeball = eyeball_of_vertex_[static_cast<std::size_t>(triangles_(0, triangle))];
    if (eyeball >= 0) {
      const auto at = static_cast<std::size_t>(eyeball);
      const Eigen::Vector3f point =
          render::interpolate(triangles_, triangle, barycentric, vertices_camera_mm);
      const float angle =
          std::acos(std::clamp((point - centres[at]).normalized().dot(gazes[at]), -1.0F, 1.0F));
      surface = angle < kPupilAngleRad ? kPupil : angle < kIrisAngleRad ? kIris : kSclera;
    } else if (style == Style::Lifelike) {
      const float brow = render::interpolate(triangles_, triangle, barycentric, brow_).x();
      const float hair = std::clamp((brow - kBrowEdgeLow) / (kBrowEdgeHigh - kBrowEdgeLow), 0.0F, 1.0F);
      surface += hair * (kBrowHair - surface);
    }
    return surface * std::max(0.0F, render::irradiance(light, normal));
  };
  constexpr int kRaysPerPixel = 4;
  return render::render_surface(render::Raycaster(vertices_camera_mm, triangles_), view.camera(), colour,
                                render::plain_picture(view.size_px, view.size_px, kBackground),
                                kRaysPerPixel);
}

}  // namespace facet::model
