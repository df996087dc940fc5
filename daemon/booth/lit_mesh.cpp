#include "booth/lit_mesh.hpp"

#include <algorithm>
#include <optional>

#include "fit/visibility.hpp"
#include "maths/threads.hpp"
#include "render/renderer.hpp"

namespace facet::booth {
namespace {

using Eigen::Matrix3Xf;
using Eigen::Vector3f;

constexpr std::size_t kThreads = 2;
constexpr float kVisibleMargin_mm = 4;
constexpr float kRim_px = 3;
constexpr float kShadowLift_mm = 0.5F;
constexpr float kLeastCosine = 0.2F;  ///< to the camera; full weight from twice of it on
/// Cosines between the normal and the middle of lamp and camera: mirrored skin is wide.
constexpr float kMirrored = 0.98F;
constexpr float kUnmirrored = 0.9F;
constexpr float kSaturated = 250;  ///< of 255

/// Grey value between four pixels, linear; nothing where one is saturated. The point is inside.
std::optional<float> sample(const Frame& frame, const Eigen::Vector2d& at_px) {
  const int x = static_cast<int>(at_px.x());
  const int y = static_cast<int>(at_px.y());
  const auto right = static_cast<float>(at_px.x() - x);
  const auto down = static_cast<float>(at_px.y() - y);
  float sum = 0;
  for (int k = 0; k < 4; ++k) {
    const std::uint8_t* value = frame.row(y + k / 2) + 4 * static_cast<std::size_t>(x + k % 2);
    if (std::max({value[0], value[1], value[2]}) >= kSaturated) {
      return std::nullopt;
    }
    const float grey = (render::srgb8_to_linear(value[0]) + render::srgb8_to_linear(value[1]) +
                        render::srgb8_to_linear(value[2])) /
                       3;
    sum += (k % 2 != 0 ? right : 1 - right) * (k / 2 != 0 ? down : 1 - down) * grey;
  }
  return sum;
}

}  // namespace

Vector3f Lamp::towards(const Vector3f& from_mm) const {
  const Vector3f way = at_mm - from_mm;
  const float distance = way.norm();
  const float depth = axis.isZero() ? distance : std::max(1.0F, -way.dot(axis));
  const float thinning = reference_mm / depth;
  return strength * thinning * thinning * (axis.isZero() ? 1 : distance / depth) / distance * way;
}

std::vector<Lamp> lamps_of(const capture::Rig& rig) {
  std::vector<Lamp> lamps;
  for (const capture::RigProjector& projector : rig.projectors) {
    Lamp& lamp = lamps.emplace_back();
    lamp.name = projector.name;
    lamp.at_mm = projector.lens.centre_mm().cast<float>();
    lamp.axis = projector.lens.camera_from_rig.linear().row(2).cast<float>();
    lamp.reference_mm = std::max(1.0F, static_cast<float>(projector.lens.camera_from_rig.translation().z()));
  }
  for (const capture::RigLight& light : rig.lights) {
    lamps.push_back({light.name, light.position_mm.cast<float>(), Vector3f::Zero(), 1000,
                     static_cast<float>(light.strength)});
  }
  return lamps;
}

void LitMesh::stand_on(const mesh::Hierarchy& hierarchy, const std::vector<float>& displacements_mm) {
  mesh::rebuild_finest(hierarchy, template_mm, displacements_mm, vertices_mm, normals);
  const mesh::OneRings& rings = hierarchy.finest().one_rings;
  first_axes.resize(3, normals.cols());
  second_axes.resize(3, normals.cols());
  for_each_vertex(normals.cols(), [&](Eigen::Index v) {
    const std::int32_t beside =
        rings.neighbours[static_cast<std::size_t>(rings.offsets[static_cast<std::size_t>(v)])];
    const Vector3f normal = normals.col(v);
    const Vector3f edge = vertices_mm.col(beside) - vertices_mm.col(v);
    first_axes.col(v) = (edge - normal.dot(edge) * normal).normalized();
    second_axes.col(v) = normal.cross(first_axes.col(v));
  });
}

void LitMesh::cast_shadows(const mesh::Level& fine, const std::vector<Lamp>& all,
                           const std::vector<std::uint8_t>& is_skin) {
  const render::Raycaster caster(vertices_mm, fine.triangles, render::Raycaster::Build::Quick);
  const Eigen::Index count = vertices_mm.cols();
  towards.clear();
  shadowless = Eigen::VectorXf::Ones(count);
  const mesh::OneRings& rings = fine.one_rings;
  for (const Shining& shining : lamps) {
    const Lamp& lamp = all[shining.lamp];
    Matrix3Xf& given = towards.emplace_back(Matrix3Xf::Zero(3, count));
    std::vector<std::uint8_t> lit(static_cast<std::size_t>(count), 0);
    for_each_vertex(count, [&](Eigen::Index v) {
      const Vector3f from_mm = vertices_mm.col(v) + kShadowLift_mm * normals.col(v);
      const Vector3f from_lamp = lamp.towards(vertices_mm.col(v));
      if (is_skin[static_cast<std::size_t>(v)] != 0 && from_lamp.dot(normals.col(v)) > 0 &&
          !caster.occluded(from_mm, lamp.at_mm, 0)) {
        given.col(v) = from_lamp;
        lit[static_cast<std::size_t>(v)] = 1;
      }
    });
    for (Eigen::Index v = 0; v < count; ++v) {
      for (auto e = rings.offsets[static_cast<std::size_t>(v)];
           e < rings.offsets[static_cast<std::size_t>(v) + 1]; ++e) {
        const auto beside = static_cast<std::size_t>(rings.neighbours[static_cast<std::size_t>(e)]);
        if (lit[beside] != lit[static_cast<std::size_t>(v)]) {
          shadowless[v] = 0;
        }
      }
    }
  }
}

float LitMesh::unmirrored(Eigen::Index v, const Vector3f& to_camera) const {
  float least = 1;
  for (const Matrix3Xf& given : towards) {
    const Vector3f half = given.col(v).normalized() + to_camera;
    if (!given.col(v).isZero()) {
      least = std::min(
          least, std::clamp((kMirrored - normals.col(v).dot(half.normalized())) / (kMirrored - kUnmirrored),
                            0.0F, 1.0F));
    }
  }
  return least;
}

void LitMesh::look(const mesh::Level& fine, const capture::Rig& rig,
                   const std::vector<std::uint8_t>& is_skin) {
  const Eigen::Index count = vertices_mm.cols();
  const auto cameras = static_cast<Eigen::Index>(rig.cameras.size());
  brightness = Eigen::MatrixXf::Zero(cameras, count);
  weight = Eigen::MatrixXf::Zero(cameras, count);
  maths::for_each_piece(rig.cameras.size(), kThreads, [&](std::size_t, std::size_t camera) {
    const capture::Lens& lens = rig.cameras[camera].lens;
    const Frame& frame = set->frames[camera];
    if (frame.empty() || frame.corrupt || frame.width_px != lens.width_px ||
        frame.height_px != lens.height_px) {
      return;
    }
    std::vector<std::uint8_t> visible;
    fit::find_visible(lens, vertices_mm, normals, fine.triangles, kVisibleMargin_mm, kRim_px, visible);
    const Vector3f centre_mm = lens.centre_mm().cast<float>();
    const auto row = static_cast<Eigen::Index>(camera);
    for (Eigen::Index v = 0; v < count; ++v) {
      const Vector3f at_mm = vertices_mm.col(v);
      const bool counts =
          is_skin[static_cast<std::size_t>(v)] != 0 && visible[static_cast<std::size_t>(v)] != 0;
      const auto at_px = counts ? lens.project(at_mm.cast<double>()) : std::nullopt;
      if (!at_px || !(at_px->minCoeff() >= 0) || !(at_px->x() < lens.width_px - 1) ||
          !(at_px->y() < lens.height_px - 1)) {
        continue;
      }
      const std::optional<float> seen = sample(frame, *at_px);
      if (seen) {
        const Vector3f to_camera = (centre_mm - at_mm).normalized();
        const float cosine = normals.col(v).dot(to_camera);
        brightness(row, v) = *seen;
        weight(row, v) = std::clamp((cosine - kLeastCosine) / kLeastCosine, 0.0F, 1.0F) * shadowless[v] *
                         unmirrored(v, to_camera);
      }
    }
  });
}

}  // namespace facet::booth
