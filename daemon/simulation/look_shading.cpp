#include "simulation/look_shading.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "simulation/gloss.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

constexpr float kPi = std::numbers::pi_v<float>;
constexpr float kLift_mm = 0.3F;  // shadow rays start off the surface by less than a wrinkle's depth
constexpr float kHiddenLight = 0.4F;
constexpr int kSkinRays = 8;    // to the surroundings; skin is fine, and its light spreads
constexpr int kOtherRays = 24;  // of coarser surfaces
constexpr float kSkinReflectance = 0.028F;
/// The skin's lobes: the mean roughness that [WMP06] measured on faces, and a narrower one of the oil on it.
struct Lobe {
  float alpha, share;
};
constexpr std::array<Lobe, 2> kLobes{{{0.30F, 0.8F}, {0.13F, 0.2F}}};

/// Two numbers from 0 to 1 that follow from a vertex and a ray: the additive recurrence of the plastic
/// number, begun anew at every vertex.
Eigen::Vector2f spread(std::uint64_t vertex, int ray) {
  const std::uint64_t start = mix(vertex);
  const auto number = [&](unsigned shift, float step) {
    const float value =
        static_cast<float>((start >> shift) & 0xFFFFFF) * 0x1p-24F + step * static_cast<float>(ray);
    return value - std::floor(value);
  };
  return {number(0, 0.7548777F), number(32, 0.5698403F)};
}

/// A light and how finely it is sampled.
struct Lamp {
  const AreaLight* light;
  int rays;
  float half_angle;  ///< as the head sees it
};

std::vector<Lamp> make_lamps(const Lighting& lighting) {
  std::vector<Lamp> lamps;
  for (const AreaLight& light : lighting.area_lights) {
    const float half_mm = std::sqrt(light.half_u_mm.norm() * light.half_v_mm.norm());
    const float angle = half_mm / light.reference_distance_mm;
    const int rays = angle > 0.25F ? 5 : angle > 0.1F ? 3 : angle > 0.03F ? 2 : 1;
    lamps.push_back({&light, lighting.area_lights.size() > 3 ? 1 : rays, angle});
  }
  return lamps;
}

/// What a surface that faces a light gets from its point: 1 at the reference distance.
float falloff(const AreaLight& light, const Vector3f& at, const Vector3f& point) {
  const Vector3f between = point - at;
  const float from_light = -between.normalized().dot(light.normal);
  return std::max(from_light, 0.0F) * light.reference_distance_mm * light.reference_distance_mm /
         between.squaredNorm();
}

/// Light on one vertex.
struct Lit {
  Vector3f diffuse{0, 0, 0};
  Vector3f mirror{0, 0, 0};
};

class Shader {
 public:
  Shader(const LookScene& scene, const Lighting& lighting, const Look& look, const Vector3f& eye_mm)
      : on_(scene), lighting_(lighting), look_(look), eye_mm_(eye_mm), lamps_(make_lamps(lighting)) {}

  bool hidden(const Vector3f& from, const Vector3f& to) const {
    return on_.surfaces.occluded(from, to, 0) || on_.strands.occluded(from, to);
  }

  /// The lamps' light on a vertex.
  Lit direct(Eigen::Index v) const {
    Lit lit;
    const Vector3f at = on_.scene.vertices_mm.col(v);
    const Vector3f normal = on_.scene.normals.col(v);
    const Vector3f from = at + kLift_mm * normal;
    const Vector3f to_eye = (eye_mm_ - at).normalized();
    const Material material = on_.scene.materials[static_cast<std::size_t>(v)];
    if (material == Material::Cloth && on_.surfaces.occluded(from, eye_mm_, 0)) {
      // Inside the head: it only tints the rim of what is seen of the neck.
      lit.diffuse = kHiddenLight * unshadowed(v);
      return lit;
    }
    int ray = 0;
    for (const Lamp& lamp : lamps_) {
      const AreaLight& light = *lamp.light;
      float diffuse = 0;
      int free = 0;
      for (int k = 0; k < lamp.rays; ++k) {
        const Eigen::Vector2f uv = 2 * spread(pattern(v), ray++).array() - 1;
        const Vector3f point = light.centre_mm + uv.x() * light.half_u_mm + uv.y() * light.half_v_mm;
        const float cosine = normal.dot((point - at).normalized());
        if (cosine <= 0 || hidden(from, point)) {
          continue;
        }
        ++free;
        diffuse += cosine * falloff(light, at, point);
      }
      const float share = 1.0F / static_cast<float>(lamp.rays);
      lit.diffuse += share * diffuse * light.irradiance;
      if (free > 0) {
        const float seen = share * static_cast<float>(free);
        lit.mirror += seen * mirror(material, v, at, normal, to_eye, lamp) * light.irradiance;
      }
    }
    return lit;
  }

  /// The lamps' light without shadows: an estimate for what throws light back.
  Vector3f unshadowed(Eigen::Index v) const {
    const Vector3f at = on_.scene.vertices_mm.col(v);
    const Vector3f normal = on_.scene.normals.col(v);
    Vector3f sum = ambient(normal);
    for (const Lamp& lamp : lamps_) {
      const float cosine = normal.dot((lamp.light->centre_mm - at).normalized());
      sum +=
          std::max(cosine, 0.0F) * falloff(*lamp.light, at, lamp.light->centre_mm) * lamp.light->irradiance;
    }
    return sum;
  }

  Vector3f ambient(const Vector3f& normal) const {
    return Vector3f::Constant(std::max(0.0F, render::irradiance(lighting_.spherical_harmonics, normal)));
  }

  /// What comes from the surroundings and, off other surfaces, from the lamps. lit: of all vertices seen.
  Lit indirect(Eigen::Index v, const std::vector<std::uint8_t>& seen, const Eigen::Matrix3Xf& lit) const {
    const Vector3f normal = on_.scene.normals.col(v);
    const Vector3f around = ambient(normal);
    const Material material = on_.scene.materials[static_cast<std::size_t>(v)];
    const bool skin = material == Material::Skin || material == Material::Hair;
    const float baked = on_.scene.openness[v];
    float open = std::isnan(baked) ? 1.0F : baked;
    Lit result;
    if (look_.occlusion || look_.bounce || std::isnan(baked)) {
      const int rays = skin ? kSkinRays : kOtherRays;
      constexpr float kReach_mm = 200;
      const Vector3f u = normal.unitOrthogonal();
      const Vector3f w = normal.cross(u);
      const Vector3f from = Vector3f(on_.scene.vertices_mm.col(v)) + kLift_mm * normal;
      int free = 0;
      for (int k = 0; k < rays; ++k) {
        const Eigen::Vector2f uv = spread(pattern(v) + 0x100000000ULL, k);
        const float turn = 2 * kPi * uv.y();
        const Vector3f direction =
            std::sqrt(uv.x()) * (std::cos(turn) * u + std::sin(turn) * w) + std::sqrt(1 - uv.x()) * normal;
        const render::Raycaster::Hit hit = on_.surfaces.first_hit(from, direction);
        if (hit.triangle < 0 || hit.distance_mm > kReach_mm) {
          ++free;
        } else if (look_.bounce) {
          const Eigen::Index at = on_.scene.triangles(0, hit.triangle);
          const Vector3f there =
              seen[static_cast<std::size_t>(at)] != 0 ? Vector3f(lit.col(at)) : 0.6F * unshadowed(at);
          result.diffuse += on_.scene.albedo.col(at).cwiseProduct(there) / static_cast<float>(rays);
        }
      }
      if (look_.occlusion || std::isnan(baked)) {
        open = static_cast<float>(free) / static_cast<float>(rays);
      }
    }
    result.diffuse += open * around;
    if (look_.gloss && skin) {
      // The surroundings mirrored: rough surfaces mirror less at grazing angles.
      const Vector3f to_eye = (eye_mm_ - on_.scene.vertices_mm.col(v)).normalized();
      const float facing = std::max(normal.dot(to_eye), 0.0F);
      const float fresnel = kSkinReflectance + 0.42F * std::pow(1 - facing, 5.0F);
      const Vector3f towards = 2 * normal.dot(to_eye) * normal - to_eye;
      result.mirror = open * fresnel * oil(v) * ambient(towards.normalized());
    }
    return result;
  }

  /// Which rays a vertex sends: skin's own each, for its light spreads; on coarse surfaces all the same, for
  /// there a change from vertex to vertex shows as grain.
  std::uint64_t pattern(Eigen::Index v) const {
    return on_.scene.materials[static_cast<std::size_t>(v)] == Material::Cloth
               ? 0
               : static_cast<std::uint64_t>(v);
  }

  float oil(Eigen::Index v) const { return v < on_.oil.size() ? on_.oil[v] : 1.0F; }

 private:
  /// A light's mirror image, per irradiance: in the skin's lobes, the eye's film, the teeth, spectacles.
  float mirror(Material material, Eigen::Index v, const Vector3f& at, const Vector3f& normal,
               const Vector3f& to_eye, const Lamp& lamp) const {
    switch (material) {
      case Material::Skin: {
        if (!look_.gloss) {
          return 0;
        }
        float sum = 0;
        for (const Lobe& lobe : kLobes) {
          sum += lobe.share * lobe_mirror(lobe.alpha, kSkinReflectance, at, normal, to_eye, lamp);
        }
        return oil(v) * sum;
      }
      case Material::Eye:
        return film_mirror(at, normal, to_eye, lamp);
      case Material::Tooth:
        return lobe_mirror(0.09F, 0.04F, at, normal, to_eye, lamp);
      case Material::Frame:
        return lobe_mirror(0.06F, 0.05F, at, normal, to_eye, lamp);
      case Material::Hair:
      case Material::Cloth:
        return 0;
    }
    return 0;
  }

  /// A rough lobe, widened by a light's extent: over a few of its points, each widened by what lies between
  /// them.
  float lobe_mirror(float alpha, float reflectance, const Vector3f& at, const Vector3f& normal,
                    const Vector3f& to_eye, const Lamp& lamp) const {
    const AreaLight& light = *lamp.light;
    const int side = lamp.half_angle > 0.1F ? 3 : 1;
    const float between = lamp.half_angle / static_cast<float>(side);
    const Gloss gloss{reflectance, std::sqrt(std::sqrt(alpha * alpha + 0.5F * between * between))};
    float sum = 0;
    for (int row = 0; row < side; ++row) {
      for (int column = 0; column < side; ++column) {
        const float u = (2 * static_cast<float>(column) + 1) / static_cast<float>(side) - 1;
        const float w = (2 * static_cast<float>(row) + 1) / static_cast<float>(side) - 1;
        const Vector3f point = light.centre_mm + u * light.half_u_mm + w * light.half_v_mm;
        sum += falloff(light, at, point) * mirrored(normal, (point - at).normalized(), to_eye, gloss);
      }
    }
    return sum / static_cast<float>(side * side);
  }

  /// A smooth film: the light's own image, its edge a little soft. A light whose irradiance is 1 at distance
  /// d shows pi d^2 / area in the same units.
  float film_mirror(const Vector3f& at, const Vector3f& normal, const Vector3f& to_eye,
                    const Lamp& lamp) const {
    constexpr float kFilm = 0.025F;
    constexpr float kLeast = 0.05F;  // of the image's half angle, that the eyeball's vertices can hold it
    constexpr float kEdge = 0.25F;
    const AreaLight& light = *lamp.light;
    const Vector3f towards = 2 * normal.dot(to_eye) * normal - to_eye;
    const float approach = -towards.dot(light.normal);
    if (approach <= 0.05F) {
      return 0;
    }
    const float length = (at - light.centre_mm).dot(light.normal) / approach;
    const Vector3f meets = at + length * towards - light.centre_mm;
    const float least_mm = kLeast * light.reference_distance_mm;
    const float half_u = std::max(light.half_u_mm.norm(), least_mm);
    const float half_v = std::max(light.half_v_mm.norm(), least_mm);
    const float u = std::abs(meets.dot(light.half_u_mm.normalized())) / half_u;
    const float w = std::abs(meets.dot(light.half_v_mm.normalized())) / half_v;
    const float inside = smooth_step(1 + kEdge, 1 - kEdge, u) * smooth_step(1 + kEdge, 1 - kEdge, w);
    const float distance = light.reference_distance_mm;
    const float fresnel = kFilm + (1 - kFilm) * std::pow(1 - std::max(normal.dot(to_eye), 0.0F), 5.0F);
    return inside * fresnel * kPi * distance * distance / (4 * half_u * half_v);
  }

  const LookScene& on_;
  const Lighting& lighting_;
  const Look& look_;
  Vector3f eye_mm_;
  std::vector<Lamp> lamps_;
};

/// Calls work(v) for every vertex marked, on up to two threads.
template <typename Work>
void for_each_marked(const std::vector<std::uint8_t>& marked, const Work& work) {
  constexpr std::size_t kBlock = 512;
  render::for_each_row(static_cast<int>((marked.size() + kBlock - 1) / kBlock), [&](int block) {
    const std::size_t end = std::min(marked.size(), (static_cast<std::size_t>(block) + 1) * kBlock);
    for (std::size_t v = static_cast<std::size_t>(block) * kBlock; v < end; ++v) {
      if (marked[v] != 0) {
        work(static_cast<Eigen::Index>(v));
      }
    }
  });
}

}  // namespace

Eigen::Matrix3Xf shade_look(const LookScene& scene, const Lighting& lighting, const Look& look,
                            const std::vector<std::uint8_t>& seen, const Eigen::Vector3f& eye_mm) {
  const Shader shader(scene, lighting, look, eye_mm);
  const Eigen::Index count = scene.scene.vertices_mm.cols();
  Eigen::Matrix3Xf diffuse = Eigen::Matrix3Xf::Zero(3, count);
  Eigen::Matrix3Xf mirror = Eigen::Matrix3Xf::Zero(3, count);
  for_each_marked(seen, [&](Eigen::Index v) {
    const Lit lit = shader.direct(v);
    diffuse.col(v) = lit.diffuse;
    mirror.col(v) = lit.mirror;
  });
  Eigen::Matrix3Xf around = Eigen::Matrix3Xf::Zero(3, count);
  for_each_marked(seen, [&](Eigen::Index v) {
    const Lit lit = shader.indirect(v, seen, diffuse);
    around.col(v) = lit.diffuse;
    mirror.col(v) += lit.mirror;
  });

  const Eigen::Matrix3Xf& albedo = scene.scene.albedo;
  if (scene.scattering == nullptr || !look.scattering) {
    return albedo.cwiseProduct(diffuse + around) + mirror;
  }
  std::vector<std::uint8_t> skin(static_cast<std::size_t>(scene.scattering->areas_mm2().size()), 0);
  for (std::size_t v = 0; v < skin.size(); ++v) {
    skin[v] = seen[v] != 0 && scene.scene.materials[v] == Material::Skin ? 1 : 0;
  }
  // Half of the colour is met going in, half coming out [DL07 sec. 14.4.6].
  diffuse += around;
  const Eigen::Matrix3Xf half = albedo.cwiseSqrt();
  const auto head = static_cast<Eigen::Index>(skin.size());
  Eigen::Matrix3Xf below = half.leftCols(head).cwiseProduct(diffuse.leftCols(head));
  scene.scattering->diffuse(skin_profile(), skin, below);
  Eigen::Matrix3Xf colours = albedo.cwiseProduct(diffuse);
  for (Eigen::Index v = 0; v < head; ++v) {
    if (skin[static_cast<std::size_t>(v)] != 0) {
      colours.col(v) = half.col(v).cwiseProduct(below.col(v)).cwiseMax(0.0F);
    }
  }
  return colours + mirror;
}

Eigen::Matrix3Xf shade_strands(const LookScene& scene, const Lighting& lighting,
                               const std::vector<std::uint8_t>& seen, const Eigen::Vector3f& eye_mm) {
  constexpr float kShine = 0.035F;     // of the strand's surface, not of its colour
  constexpr float kNarrow = 24;        // exponent of the highlight
  constexpr float kSelfShadow = 0.8F;  // by the strand's neighbours
  const HairStrands& hair = scene.hair;
  const render::Strands& strands = scene.strands.strands();
  const std::vector<Lamp> lamps = make_lamps(lighting);
  Eigen::Matrix3Xf colours = Eigen::Matrix3Xf::Zero(3, strands.points.cols());
  for_each_marked(seen, [&](Eigen::Index strand) {
    const auto k = static_cast<std::size_t>(strand);
    const Eigen::Index first = hair.first[k];
    const Eigen::Index end = hair.first[k + 1];
    const Vector3f normal =
        render::interpolate(scene.scene.triangles, hair.triangle[k], hair.barycentric[k], scene.scene.normals)
            .normalized();
    const Vector3f tip = strands.points.col(end - 1).head<3>();
    const Vector3f from = Vector3f(strands.points.col((first + end) / 2).head<3>()) + kLift_mm * normal;
    const Vector3f to_eye = (eye_mm - tip).normalized();
    const Vector3f albedo = hair.albedo[k];
    const auto add = [&](const Vector3f& to_light, const Vector3f& light) {
      for (Eigen::Index p = first; p < end; ++p) {
        const Eigen::Index other = p + 1 < end ? p + 1 : p - 1;
        const Vector3f along =
            (strands.points.col(other).head<3>() - strands.points.col(p).head<3>()).normalized();
        const float cos_light = along.dot(to_light);
        const float cos_eye = along.dot(to_eye);
        const float sin_light = std::sqrt(std::max(0.0F, 1 - cos_light * cos_light));
        const float sin_eye = std::sqrt(std::max(0.0F, 1 - cos_eye * cos_eye));
        const float peak = std::pow(std::max(0.0F, sin_light * sin_eye - cos_light * cos_eye), kNarrow);
        colours.col(p) +=
            light.cwiseProduct(sin_light * albedo + peak * (Vector3f::Constant(kShine) + albedo));
      }
    };
    for (const Lamp& lamp : lamps) {
      const AreaLight& light = *lamp.light;
      const Vector3f to_light = (light.centre_mm - from).normalized();
      // Deep in the shade of the head itself no ray is needed.
      const float facing = smooth_step(-0.25F, 0.5F, normal.dot(to_light));
      if (facing > 0 && !scene.surfaces.occluded(from, light.centre_mm, 0)) {
        add(to_light, kSelfShadow * facing * falloff(light, from, light.centre_mm) * light.irradiance);
      }
    }
    if (lighting.area_lights.empty()) {
      for (std::size_t l = 0; l < lighting.main_directions.size(); ++l) {
        const float facing = smooth_step(-0.25F, 0.5F, normal.dot(lighting.main_directions[l]));
        add(lighting.main_directions[l],
            Vector3f::Constant(kSelfShadow * facing * lighting.main_strengths[l]));
      }
    }
    const float around = lighting.area_lights.empty()
                             ? lighting.spherical_harmonics[0]
                             : std::max(0.0F, render::irradiance(lighting.spherical_harmonics, normal));
    for (Eigen::Index p = first; p < end; ++p) {
      colours.col(p) += kSelfShadow * around * albedo;
    }
  });
  return colours;
}

}  // namespace facet::simulation
