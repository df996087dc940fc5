#include "simulation/wrinkles.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <string_view>

#include "render/renderer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kMaxStrength = 1.15F;  // several expressions together fold a little deeper than each alone

/// A crease's course over the face, seen from the front, and its form.
struct Crease {
  std::vector<Vector2f> course_mm;  ///< x, y in the head frame
  float depth_mm = 0;
  float half_width_mm = 0;  ///< where the groove has risen to 1/e of its depth
};

/// The groove's cross-section: a furrow with a low bank on either side, so that skin is pushed, not removed.
float cross_section(float distance_mm, float half_width_mm) {
  const float groove = distance_mm / half_width_mm;
  const float bank = (distance_mm - 2.2F * half_width_mm) / (1.2F * half_width_mm);
  return -std::exp(-groove * groove) + 0.4F * std::exp(-bank * bank);
}

/// Lays creases onto a face: finds where each course meets the surface and pulls the skin in around it.
class Carver {
 public:
  Carver(const RestingSkin& resting, std::uint64_t seed)
      : resting_(resting), caster_(resting.vertices_mm, resting.triangles), noise_(seed, 51) {}

  void carve(const Crease& crease, Eigen::VectorXf& pattern_mm) const {
    std::vector<Vector3f> path;
    for (const Vector2f& point : resampled(crease.course_mm)) {
      constexpr float kInFront_mm = 300;
      const auto hit = caster_.first_hit({point.x(), point.y(), kInFront_mm}, {0, 0, -1}, 0, true);
      if (hit.triangle >= 0) {
        path.emplace_back(point.x(), point.y(), kInFront_mm - hit.distance_mm);
      }
    }
    if (path.size() < 2) {
      return;
    }
    const float reach_mm = 5 * crease.half_width_mm;
    Eigen::AlignedBox3f box;
    for (const Vector3f& point : path) {
      box.extend(point);
    }
    const float parts = static_cast<float>(path.size() - 1);
    for (Eigen::Index v = 0; v < resting_.vertices_mm.cols(); ++v) {
      const Vector3f at = resting_.vertices_mm.col(v);
      if (resting_.skin[v] <= 0 || box.squaredExteriorDistance(at) > reach_mm * reach_mm) {
        continue;
      }
      float nearest_mm = reach_mm;
      float along = 0;
      for (std::size_t k = 0; k + 1 < path.size(); ++k) {
        const Vector3f edge = path[k + 1] - path[k];
        const float part = std::clamp((at - path[k]).dot(edge) / edge.squaredNorm(), 0.0F, 1.0F);
        const float distance_mm = (at - path[k] - part * edge).norm();
        if (distance_mm < nearest_mm) {
          nearest_mm = distance_mm;
          along = (static_cast<float>(k) + part) / parts;
        }
      }
      if (nearest_mm < reach_mm) {
        // Creases run out towards their ends and vary on the way.
        const float taper = smooth_step(0, 0.2F, along) * smooth_step(1, 0.8F, along);
        const float uneven = 1 + 0.3F * noise_.at(at / 9.0F);
        pattern_mm[v] += crease.depth_mm * taper * uneven * cross_section(nearest_mm, crease.half_width_mm);
      }
    }
  }

  /// A soft pad of raised skin around a point.
  void raise(const Vector3f& centre_mm, float radius_mm, float height_mm, Eigen::VectorXf& pattern_mm) const {
    for (Eigen::Index v = 0; v < resting_.vertices_mm.cols(); ++v) {
      const float distance = (resting_.vertices_mm.col(v) - centre_mm).norm() / radius_mm;
      pattern_mm[v] += height_mm * std::exp(-distance * distance);
    }
  }

 private:
  /// The course with points 1.5 mm apart, through its corners smoothly [CR74].
  static std::vector<Vector2f> resampled(const std::vector<Vector2f>& course) {
    constexpr float kStep_mm = 1.5F;
    std::vector<Vector2f> points;
    for (std::size_t k = 0; k + 1 < course.size(); ++k) {
      const Vector2f& before = course[k > 0 ? k - 1 : 0];
      const Vector2f& after = course[std::min(k + 2, course.size() - 1)];
      const Vector2f& from = course[k];
      const Vector2f& to = course[k + 1];
      const int steps = std::max(1, static_cast<int>((to - from).norm() / kStep_mm));
      for (int step = 0; step < steps; ++step) {
        const float t = static_cast<float>(step) / static_cast<float>(steps);
        const Vector2f a = 2 * from;
        const Vector2f b = to - before;
        const Vector2f c = 2 * before - 5 * from + 4 * to - after;
        const Vector2f d = -before + 3 * from - 3 * to + after;
        points.emplace_back(0.5F * (a + t * (b + t * (c + t * d))));
      }
    }
    points.push_back(course.back());
    return points;
  }

  const RestingSkin& resting_;
  render::Raycaster caster_;
  Noise noise_;
};

Vector2f front(const Vector3f& point) {
  return point.head<2>();
}

/// Lines across the forehead, wavy and broken.
void forehead_lines(const Anatomy& face, const Carver& carver, Random& random, Eigen::VectorXf& pattern_mm) {
  const float bottom_mm = 0.5F * (face.brow[0].y() + face.brow[1].y()) + 5;
  const float top_mm = face.forehead.y() - 7;
  const float half_length_mm = 0.95F * 0.5F * (face.brow[1] - face.brow[0]).norm() + 14;
  int count = std::clamp(static_cast<int>((top_mm - bottom_mm) / 8), 2, 6);
  for (int line = 0; line < count; ++line) {
    const float height_mm =
        bottom_mm + (top_mm - bottom_mm) * (static_cast<float>(line) + 0.3F) / static_cast<float>(count);
    const float length = half_length_mm * random.uniform(0.7F, 1.05F);
    const float shift = random.uniform(-6, 6);
    Crease crease;
    for (int point = 0; point <= 8; ++point) {
      const float part = static_cast<float>(point) / 4 - 1;
      // Follows the brows: a little lower over the nose and at the temples.
      const float wave = 1.6F * std::cos(2 * std::numbers::pi_v<float> * part) - 3.0F * part * part;
      crease.course_mm.emplace_back(shift + part * length, height_mm - wave + random.uniform(-0.9F, 0.9F));
    }
    crease.depth_mm = random.uniform(0.45F, 0.75F);
    crease.half_width_mm = random.uniform(0.95F, 1.35F);
    carver.carve(crease, pattern_mm);
  }
}

/// Upright lines between the brows.
void frown_lines(const Anatomy& face, const Carver& carver, Random& random, Eigen::VectorXf& pattern_mm) {
  const float apart_mm = 0.5F * (face.eye_inner[1].x() - face.eye_inner[0].x());
  for (const float side : {-1.0F, 1.0F}) {
    const float x = face.nasion.x() + side * apart_mm * random.uniform(0.4F, 0.55F);
    Crease crease;
    crease.course_mm = {{x, face.nasion.y() + 2},
                        {x - side * 1.5F, face.nasion.y() + 9},
                        {x + side * 0.5F, face.nasion.y() + random.uniform(17, 24)}};
    crease.depth_mm = random.uniform(0.5F, 0.8F);
    crease.half_width_mm = random.uniform(0.9F, 1.2F);
    carver.carve(crease, pattern_mm);
  }
  Crease across;  // and one across the root of the nose
  across.course_mm = {{face.nasion.x() - 0.55F * apart_mm, face.nasion.y() - 2},
                      {face.nasion.x(), face.nasion.y() - 3},
                      {face.nasion.x() + 0.55F * apart_mm, face.nasion.y() - 2}};
  across.depth_mm = 0.35F;
  across.half_width_mm = 0.9F;
  carver.carve(across, pattern_mm);
}

/// A fan of lines outwards from the outer corner of one eye.
void crows_feet(const Anatomy& face, std::size_t eye, const Carver& carver, Random& random,
                Eigen::VectorXf& pattern_mm) {
  const float side = Anatomy::side(eye);
  const Vector2f corner = front(face.eye_outer[eye]);
  for (const float slope : {0.55F, 0.15F, -0.25F, -0.65F}) {
    const float rise = slope + random.uniform(-0.1F, 0.1F);
    const float length_mm = random.uniform(12, 19);
    const Vector2f direction = Vector2f(side, rise).normalized();
    Crease crease;
    crease.course_mm = {corner + 5.0F * direction,
                        corner + (5 + 0.5F * length_mm) * direction + Vector2f(0, -0.8F * slope),
                        corner + (5 + length_mm) * direction + Vector2f(0, -3.0F * slope - 0.8F)};
    crease.depth_mm = random.uniform(0.3F, 0.55F);
    crease.half_width_mm = random.uniform(0.65F, 0.95F);
    carver.carve(crease, pattern_mm);
  }
}

/// Arcs under one eye.
void lower_lid_lines(const Anatomy& face, std::size_t eye, const Carver& carver, Random& random,
                     Eigen::VectorXf& pattern_mm) {
  const Vector2f inner = front(face.eye_inner[eye]);
  const Vector2f outer = front(face.eye_outer[eye]);
  const Vector2f middle = front(face.lid_lower[eye]);
  for (const float drop_mm : {5.0F, 9.0F}) {
    const float drop = drop_mm + random.uniform(-0.7F, 0.7F);
    Crease crease;
    crease.course_mm = {inner + Vector2f(0, -0.6F * drop),
                        0.5F * (inner + middle) + Vector2f(0, -0.95F * drop), middle + Vector2f(0, -drop),
                        0.5F * (outer + middle) + Vector2f(0, -0.9F * drop),
                        outer + Vector2f(0, -0.35F * drop)};
    crease.depth_mm = random.uniform(0.3F, 0.45F);
    crease.half_width_mm = random.uniform(0.7F, 1.0F);
    carver.carve(crease, pattern_mm);
  }
}

/// From the wing of the nose down past the corner of the mouth, with the cheek raised beside it.
void nasolabial_fold(const Anatomy& face, std::size_t cheek, const Carver& carver, Random& random,
                     Eigen::VectorXf& pattern_mm) {
  const float side = Anatomy::side(cheek);
  const Vector2f corner = front(face.mouth_corner[cheek]);
  const float centre = face.nose_tip.x();
  const float wing_mm = centre + side * random.uniform(17.5F, 20.5F);
  const Vector2f top(wing_mm, face.nose_tip.y() + 5);
  const Vector2f end(corner.x() + side * random.uniform(6, 9), corner.y() - random.uniform(1, 8));
  Crease crease;
  crease.course_mm = {top,
                      {top.x() + 0.35F * (end.x() - top.x()), top.y() + 0.3F * (end.y() - top.y())},
                      {top.x() + 0.8F * (end.x() - top.x()), top.y() + 0.65F * (end.y() - top.y())},
                      end};
  crease.depth_mm = random.uniform(0.6F, 0.8F);
  crease.half_width_mm = random.uniform(1.1F, 1.4F);
  carver.carve(crease, pattern_mm);
  const Vector2f beside = 0.5F * (top + end) + Vector2f(side * 8, 5);
  carver.raise({beside.x(), beside.y(), face.mouth_corner[cheek].z()}, 12, 0.8F, pattern_mm);
}

/// Bracket-shaped lines in the cheek beside the mouth.
void smile_lines(const Anatomy& face, std::size_t cheek, const Carver& carver, Random& random,
                 Eigen::VectorXf& pattern_mm) {
  const float side = Anatomy::side(cheek);
  const Vector2f corner = front(face.mouth_corner[cheek]);
  for (const float out_mm : {13.0F, 19.0F}) {
    const float out = out_mm + random.uniform(-1, 1);
    Crease crease;
    crease.course_mm = {corner + Vector2f(side * (out - 3), 12), corner + Vector2f(side * out, 4),
                        corner + Vector2f(side * (out - 1), -4), corner + Vector2f(side * (out - 4), -10)};
    crease.depth_mm = random.uniform(0.2F, 0.4F);
    crease.half_width_mm = random.uniform(0.9F, 1.2F);
    carver.carve(crease, pattern_mm);
  }
}

}  // namespace

Wrinkles::Wrinkles(const Anatomy& anatomy, const RestingSkin& resting, std::uint64_t seed,
                   const std::vector<std::string>& expression_names) {
  const Carver carver(resting, seed);
  Random random(seed, 52);
  const Eigen::Index count = resting.vertices_mm.cols();
  const float age = random.uniform(0.35F, 1.0F);  // how much of each fold stays at rest

  struct Driver {
    std::string_view name;
    float weight;
  };
  const auto fold = [&](float resting_strength, std::initializer_list<Driver> drivers) -> Eigen::VectorXf& {
    Fold made;
    made.pattern_mm = Eigen::VectorXf::Zero(count);
    made.resting = age * resting_strength;
    for (const Driver& driver : drivers) {
      const auto found = std::find(expression_names.begin(), expression_names.end(), driver.name);
      if (found != expression_names.end()) {
        made.by.emplace_back(static_cast<std::size_t>(found - expression_names.begin()), driver.weight);
      }
    }
    folds_.push_back(std::move(made));
    return folds_.back().pattern_mm;
  };

  forehead_lines(
      anatomy, carver, random,
      fold(0.25F, {{"browInnerUp", 0.55F}, {"browOuterUpLeft", 0.3F}, {"browOuterUpRight", 0.3F}}));
  frown_lines(anatomy, carver, random, fold(0.2F, {{"browDownLeft", 0.5F}, {"browDownRight", 0.5F}}));
  for (const std::size_t side : {std::size_t{0}, std::size_t{1}}) {
    const bool left = side == 1;
    crows_feet(anatomy, side, carver, random,
               fold(0.2F, {{left ? "eyeSquintLeft" : "eyeSquintRight", 0.6F},
                           {left ? "cheekSquintLeft" : "cheekSquintRight", 0.4F},
                           {left ? "mouthSmileLeft" : "mouthSmileRight", 0.3F}}));
    lower_lid_lines(anatomy, side, carver, random,
                    fold(0.4F, {{left ? "eyeSquintLeft" : "eyeSquintRight", 0.5F},
                                {left ? "cheekSquintLeft" : "cheekSquintRight", 0.4F}}));
    nasolabial_fold(anatomy, side, carver, random,
                    fold(0.35F, {{left ? "mouthSmileLeft" : "mouthSmileRight", 0.8F},
                                 {left ? "noseSneerLeft" : "noseSneerRight", 0.5F},
                                 {left ? "mouthUpperUpLeft" : "mouthUpperUpRight", 0.3F}}));
    smile_lines(anatomy, side, carver, random,
                fold(0.05F, {{left ? "mouthSmileLeft" : "mouthSmileRight", 0.9F},
                             {left ? "mouthStretchLeft" : "mouthStretchRight", 0.3F}}));
  }

  // The chin's dimples and the lips' upright lines are fields, not lines.
  Eigen::VectorXf& chin = fold(0.1F, {{"mouthShrugLower", 0.9F},
                                      {"mouthPressLeft", 0.4F},
                                      {"mouthPressRight", 0.4F},
                                      {"mouthPucker", 0.6F}});
  const Vector3f chin_pad = 0.6F * anatomy.chin + 0.4F * anatomy.lip_lower;
  const Noise dimples(seed, 53);
  for (Eigen::Index v = 0; v < count; ++v) {
    const Vector3f at = resting.vertices_mm.col(v);
    const float reach = (at - chin_pad).head<2>().norm() / 13;
    chin[v] = 0.35F * std::exp(-reach * reach) * dimples.at(at / 4.5F);
  }
  Eigen::VectorXf& lip_lines = fold(0.5F, {{"mouthPucker", 0.8F}, {"mouthFunnel", 0.3F}});
  const Noise across(seed, 54);
  for (Eigen::Index v = 0; v < count; ++v) {
    const Vector3f at = resting.vertices_mm.col(v);
    lip_lines[v] = 0.12F * resting.lips[v] * across.at({at.x() / 2.1F, at.y() / 9.0F, at.z() / 9.0F});
  }

  const Noise pores(seed, 55);
  const Noise unevenness(seed, 56);
  always_mm_.resize(count);
  for (Eigen::Index v = 0; v < count; ++v) {
    const Vector3f at = resting.vertices_mm.col(v);
    always_mm_[v] = 0.022F * pores.at(at / 2.2F) + 0.09F * unevenness.fractal(at / 11.0F, 2);
  }

  for (Fold& each : folds_) {
    each.pattern_mm.array() *= resting.skin.array();
  }
  always_mm_.array() *= resting.skin.array();
}

void Wrinkles::relief_mm(std::span<const float> expression, Eigen::VectorXf& relief_mm) const {
  relief_mm = always_mm_;
  for (const Fold& fold : folds_) {
    float strength = fold.resting;
    for (const auto& [index, weight] : fold.by) {
      strength += (1 - fold.resting) * weight * expression[index];
    }
    relief_mm += std::min(strength, kMaxStrength) * fold.pattern_mm;
  }
}

}  // namespace facet::simulation
