#include "simulation/shading.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "simulation/gloss.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

constexpr float kLift_mm = 0.3F;  // shadow rays start off the surface by less than a wrinkle's depth

Gloss gloss_of(Material material, bool highlights) {
  switch (material) {
    case Material::Eye:
      return {0.03F, 0.16F};
    case Material::Tooth:
      return {0.04F, 0.3F};
    case Material::Frame:
      return {0.05F, 0.25F};
    case Material::Skin:
      return highlights ? Gloss{0.028F, 0.38F} : Gloss{};
    case Material::Hair:
    case Material::Cloth:
      return {};
  }
  return {};
}

/// Part of the hemisphere that is free within reach_mm, by 16 cosine-weighted rays.
float find_openness(const render::Raycaster& caster, const Vector3f& at, const Vector3f& normal,
                    float reach_mm) {
  constexpr int kRays = 16;
  const Vector3f u = normal.unitOrthogonal();
  const Vector3f v = normal.cross(u);
  const Vector3f from = at + kLift_mm * normal;
  float open = 0;
  for (int ray = 0; ray < kRays; ++ray) {
    const float part = (static_cast<float>(ray) + 0.5F) / kRays;
    const float turn = static_cast<float>(ray) * 2.39996F;  // the golden angle
    const Vector3f direction =
        std::sqrt(part) * (std::cos(turn) * u + std::sin(turn) * v) + std::sqrt(1 - part) * normal;
    open += caster.occluded(from, from + reach_mm * direction, 0) ? 0.0F : 1.0F;
  }
  return open / kRays;
}

struct LightSamples {
  const AreaLight* light;
  std::vector<Vector3f> points_mm;
};

}  // namespace

void Scene::clear() {
  *this = Scene{};
}

void Scene::add(const mesh::Vertices& part_mm, const Eigen::Matrix3Xf& part_normals,
                const Eigen::Matrix3Xf& part_albedo, const std::vector<Material>& part_materials,
                const mesh::Triangles& part_triangles, const Eigen::VectorXf& part_openness) {
  const auto append = [](auto& onto, const auto& part) {
    onto.conservativeResize(3, onto.cols() + part.cols());
    onto.rightCols(part.cols()) = part;
  };
  const auto before = static_cast<std::int32_t>(vertices_mm.cols());
  append(vertices_mm, part_mm);
  append(normals, part_normals);
  append(albedo, part_albedo);
  materials.insert(materials.end(), part_materials.begin(), part_materials.end());
  openness.conservativeResize(vertices_mm.cols());
  if (part_openness.size() == part_mm.cols()) {
    openness.tail(part_mm.cols()) = part_openness;
  } else {
    openness.tail(part_mm.cols()).setConstant(std::numeric_limits<float>::quiet_NaN());
  }
  append(triangles, mesh::Triangles(part_triangles.array() + before));
}

Eigen::Matrix3Xf shade_vertices(const Scene& scene, const render::Raycaster& caster, const Lighting& lighting,
                                bool highlights, const Vector3f& eye_mm) {
  constexpr int kBlock = 512;     // vertices per call
  constexpr int kKeySamples = 4;  // squared: shadow rays to the first light
  constexpr int kFillSamples = 3;
  constexpr float kPropReach_mm = 60;  // of what may darken an eye, a tooth or the neck
  std::vector<LightSamples> lights;
  for (const AreaLight& light : lighting.area_lights) {
    const bool many = lighting.area_lights.size() > 3;  // as a ring's diodes: together they are spread out
    lights.push_back({&light, light_points_mm(light, many             ? 1
                                                     : lights.empty() ? kKeySamples
                                                                      : kFillSamples)});
  }
  const Eigen::Index count = scene.vertices_mm.cols();
  Eigen::Matrix3Xf colours = Eigen::Matrix3Xf::Zero(3, count);
  const bool area = lighting.kind != LightKind::SphericalHarmonics;

  render::for_each_row(static_cast<int>((count + kBlock - 1) / kBlock), [&](int block) {
    const Eigen::Index end = std::min<Eigen::Index>(count, static_cast<Eigen::Index>(block + 1) * kBlock);
    for (Eigen::Index v = static_cast<Eigen::Index>(block) * kBlock; v < end; ++v) {
      const Vector3f at = scene.vertices_mm.col(v);
      const Vector3f normal = scene.normals.col(v);
      const Vector3f to_eye = (eye_mm - at).normalized();
      // Vertices just over the horizon still colour triangles that are seen.
      if (normal.isZero() || normal.dot(to_eye) < -0.3F) {
        continue;
      }
      const Material material = scene.materials[static_cast<std::size_t>(v)];
      const Gloss gloss = gloss_of(material, highlights);
      float open = scene.openness[v];
      const bool baked = !std::isnan(open);
      // A hidden vertex only tints the rim of what is seen: shadow rays would be wasted on it.
      constexpr float kHiddenLight = 0.4F;
      const bool hidden = (area || !baked) && caster.occluded(at + kLift_mm * normal, eye_mm, 0);
      if (!baked) {
        open = hidden ? kHiddenLight : find_openness(caster, at, normal, kPropReach_mm);
      } else if (!area) {
        open = 1;  // the shading model knows no shadows
      }
      Vector3f light_sum =
          Vector3f::Constant(open * std::max(0.0F, render::irradiance(lighting.spherical_harmonics, normal)));
      Vector3f mirror_sum = Vector3f::Zero();
      for (const LightSamples& samples : lights) {
        const AreaLight& light = *samples.light;
        const float share = 1.0F / static_cast<float>(samples.points_mm.size());
        const Vector3f from = at + kLift_mm * normal;
        float diffuse = 0;
        float mirror = 0;
        for (const Vector3f& point : samples.points_mm) {
          const Vector3f between = point - at;
          const Vector3f to_light = between.normalized();
          const float cosine = normal.dot(to_light);
          const float from_light = -to_light.dot(light.normal);
          if (cosine <= 0 || from_light <= 0 || (!hidden && caster.occluded(from, point, 0))) {
            continue;
          }
          const float falloff =
              from_light * light.reference_distance_mm * light.reference_distance_mm / between.squaredNorm();
          diffuse += cosine * falloff;
          if (gloss.reflectance > 0) {
            mirror += falloff * mirrored(normal, to_light, to_eye, gloss);
          }
        }
        light_sum += (hidden ? kHiddenLight : 1.0F) * share * diffuse * light.irradiance;
        mirror_sum += share * mirror * light.irradiance;
      }
      if (!area && gloss.reflectance > 0) {
        for (std::size_t k = 0; k < lighting.main_directions.size(); ++k) {
          mirror_sum.array() += open * lighting.main_strengths[k] *
                                mirrored(normal, lighting.main_directions[k], to_eye, gloss);
        }
      }
      colours.col(v) = scene.albedo.col(v).cwiseProduct(light_sum) + mirror_sum;
    }
  });
  return colours;
}

}  // namespace facet::simulation
