#include "simulation/strands.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "render/renderer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

/// A point of a line of points, part 0 to 1 of the way by number.
Vector3f along_line(const std::vector<Vector3f>& line, float part) {
  const float at = std::clamp(part, 0.0F, 1.0F) * static_cast<float>(line.size() - 1);
  const auto low = std::min(static_cast<std::size_t>(at), line.size() - 2);
  const float rest = at - static_cast<float>(low);
  // A Catmull-Rom spline [CR74]: landmarks are few, lids are round.
  const Vector3f& b = line[low];
  const Vector3f& c = line[low + 1];
  const Vector3f a = low > 0 ? line[low - 1] : Vector3f(2 * b - c);
  const Vector3f d = low + 2 < line.size() ? line[low + 2] : Vector3f(2 * c - b);
  return 0.5F * (2 * b + rest * (c - a) + rest * rest * (2 * a - 5 * b + 4 * c - d) +
                 rest * rest * rest * (3 * (b - c) + d - a));
}

/// Axes of the skin at a point of a triangle: along its first edge, across, off the skin.
Eigen::Matrix3f skin_frame(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                           const mesh::Triangles& triangles, std::int32_t triangle,
                           const Vector2f& barycentric) {
  Vector3f normal = render::interpolate(triangles, triangle, barycentric, normals);
  const Vector3f edge = vertices_mm.col(triangles(1, triangle)) - vertices_mm.col(triangles(0, triangle));
  normal = normal.norm() > 1e-3F ? normal.normalized() : edge.unitOrthogonal();
  Vector3f first = edge - edge.dot(normal) * normal;
  first = first.norm() > 1e-6F ? first.normalized() : normal.unitOrthogonal();
  Eigen::Matrix3f frame;
  frame << first, normal.cross(first), normal;
  return frame;
}

/// Puts hairs on a head, one after the other.
class Barber {
 public:
  Barber(const Scalp& scalp, const Anatomy& anatomy, const Person& person, std::uint64_t seed)
      : scalp_(scalp),
        face_(anatomy),
        person_(person),
        surface_(scalp.vertices_mm, scalp.triangles, render::Raycaster::Build::Quick),
        random_(seed, 55),
        clump_(seed, 56),
        whirl_(seed, 57) {}

  void grow_brow(std::size_t side, const std::vector<Vector3f>& upper, const std::vector<Vector3f>& lower) {
    constexpr int kHairs = 520;
    if (upper.size() < 2 || lower.size() < 2) {
      return;
    }
    const Vector3f outwards(Anatomy::side(side), 0, 0);
    const float thin = random_.uniform(0.75F, 1.0F);
    for (int k = 0; k < kHairs; ++k) {
      const float part = std::pow(random_.uniform(), 0.9F);
      // The landmarks' band is wider than the hair's, most of all at its outer end.
      const float width = thin * (0.95F - 0.2F * part);
      const float across = 0.5F + width * (random_.uniform() - 0.5F);
      // Some models' landmarks lie close together: a brow is 8 mm high at the nose, 5 at its end.
      const Vector3f middle = 0.5F * (along_line(lower, part) + along_line(upper, part));
      Vector3f upwards = along_line(upper, part) - along_line(lower, part);
      upwards.y() = std::max(upwards.y(), 8.5F - 3.0F * part);
      const Vector3f at = middle + (across - 0.5F) * upwards;
      const Vector3f next = along_line(upper, std::min(part + 0.1F, 1.0F)) - along_line(upper, part - 0.02F);
      const Vector3f along = next.norm() > 1e-3F ? next.normalized() : outwards;
      const float upright = smooth_step(0.42F, 0.0F, part);
      const float lean = 0.75F - 1.5F * across + 0.25F * clump_.at(at / 2.5F);
      Vector3f direction =
          (1 - 0.85F * upright) * along + (upright + (1 - upright) * 0.55F * lean) * Vector3f(0, 1, 0);
      direction += 0.18F * jitter();
      const float length_mm =
          (5.0F + 3.5F * std::sin(3.1F * std::min(part + 0.15F, 1.0F))) * random_.uniform(0.75F, 1.1F);
      lay({at, direction, length_mm, 4, 0.25F, 0.9F, 0.05F});
    }
  }

  /// The lashes of one lid, in a few rows along its margin; they leave it forwards and curl away from the
  /// eye.
  void grow_lashes(const std::vector<Vector3f>& margin, const Vector3f& eye_mm, bool upper) {
    if (margin.size() < 2) {
      return;
    }
    const int count = upper ? 210 : 90;
    const float away = upper ? 1.0F : -1.0F;
    for (int k = 0; k < count; ++k) {
      const float part = 0.06F + 0.92F * random_.uniform();
      // In a few rows, the first on the margin itself.
      const Vector3f at = along_line(margin, part) + Vector3f(0, 0.5F * away * random_.uniform(), 0);
      const float fan = (at.x() - eye_mm.x()) / 14;
      const float length_mm =
          (upper ? 8.5F : 5.0F) * (0.55F + 0.45F * std::sin(3.14F * part)) * random_.uniform(0.7F, 1.05F);
      const Vector3f start = Vector3f(0.45F * fan, upper ? -0.25F : -0.45F, 0.85F) + 0.12F * jitter();
      const Vector3f end = Vector3f(0.75F * fan, 0.85F * away, 0.55F) + 0.15F * jitter();
      Root root;
      if (!find_root(at, root)) {
        continue;
      }
      constexpr int kSteps = 5;
      std::vector<Vector3f> points{at};
      for (int p = 0; p < kSteps; ++p) {
        const float bend = (static_cast<float>(p) + 0.5F) / kSteps;
        points.emplace_back(points.back() + length_mm / kSteps * (start + bend * (end - start)).normalized());
      }
      add(root, points, upper ? 0.05F : 0.035F, 0.35F * person_.complexion.hair);
    }
  }

  void grow_beard() {
    constexpr int kHairs = 9000;
    if (person_.beard_mm <= 0) {
      return;
    }
    const auto density = [&](Eigen::Index v) {
      const float zone = beard_zone(face_, scalp_.vertices_mm.col(v)) * scalp_.zones.skin[v] *
                         (1 - smooth_step(0.02F, 0.3F, scalp_.zones.lips[v]));
      return zone *
             std::clamp(0.75F + 0.6F * whirl_.fractal(scalp_.vertices_mm.col(v) / 14.0F, 2), 0.1F, 1.0F);
    };
    scatter(kHairs, density, [&](const Vector3f& at) {
      const float side = std::clamp((at.x() - face_.nose_tip.x()) / 25, -1.0F, 1.0F);
      Vector3f direction(0.5F * side, -0.9F, 0.25F);
      direction += 0.35F * Vector3f(clump_.at(at / 5.0F), 0, clump_.at(at / 5.0F + Vector3f(9, 0, 0))) +
                   0.25F * jitter();
      const float length_mm = person_.beard_mm * random_.uniform(0.5F, 1.25F);
      const int points = person_.beard_mm < 2 ? 2 : 4;
      lay({at, direction, length_mm, points, 0.45F, 0.35F, 0.045F});
    });
  }

  /// Hair of the head: combed back and to the sides, shorter and thinner towards the hairline.
  void grow_head() {
    constexpr int kHairs = 16'000;
    const float length = random_.uniform(14, 26);
    const auto density = [&](Eigen::Index v) { return std::sqrt(smooth_step(0.0F, 0.35F, scalp_.hair[v])); };
    scatter(kHairs, density, [&](const Vector3f& at) {
      const Vector3f top = face_.nasion + Vector3f(0, 60, -70);
      const Vector3f outwards = (at - top).normalized();
      const float lock = clump_.fractal(at / 9.0F, 2);
      Vector3f direction =
          Vector3f(0.4F * outwards.x(), 0.25F - 0.9F * smooth_step(0.2F, -0.5F, outwards.y()), -0.8F) +
          Vector3f(0.5F * lock, 0.3F * whirl_.at(at / 13.0F), 0) + 0.2F * jitter();
      lay({at, direction, length * random_.uniform(0.6F, 1.2F) * (0.45F + 0.55F * nearest_hair_), 5, 0.2F,
           2.2F, 0.05F});
    });
  }

  HairStrands take() { return std::move(strands_); }

 private:
  Vector3f jitter() { return {random_.uniform(-1, 1), random_.uniform(-1, 1), random_.uniform(-1, 1)}; }

  struct Root {
    std::int32_t triangle = -1;
    Vector2f barycentric{0, 0};
    Eigen::Matrix3f frame;
    Vector3f at_mm;
  };
  bool find_root(const Vector3f& at, Root& root) const;

  struct Lying {
    Vector3f at;
    Vector3f direction;
    float length_mm;
    int points;
    float rise;    ///< of the root off the skin, in hair lengths a length
    float top_mm;  ///< how far off the skin the tip ends
    float radius_mm;
  };
  /// A hair that follows the skin.
  void lay(const Lying& hair);

  void add(const Root& root, const std::vector<Vector3f>& points, float radius_mm, const Vector3f& albedo);

  /// count places spread by density over the surface, and what to grow there.
  template <typename Density, typename Grow>
  void scatter(int count, const Density& density, const Grow& grow);

  const Scalp& scalp_;
  const Anatomy& face_;
  const Person& person_;
  render::Raycaster surface_;
  Random random_;
  Noise clump_;
  Noise whirl_;
  float nearest_hair_ = 0;  ///< Scalp::hair where the last place lies
  HairStrands strands_;
};

bool Barber::find_root(const Vector3f& at, Root& root) const {
  constexpr float kReach_mm = 6;
  const render::Raycaster::Closest closest = surface_.closest_point(at, kReach_mm);
  if (closest.triangle < 0) {
    return false;
  }
  root.triangle = closest.triangle;
  root.barycentric = closest.barycentric;
  root.at_mm = closest.point_mm;
  root.frame =
      skin_frame(scalp_.vertices_mm, scalp_.normals, scalp_.triangles, closest.triangle, closest.barycentric);
  return true;
}

void Barber::lay(const Lying& hair) {
  Root root;
  if (!find_root(hair.at, root)) {
    return;
  }
  std::vector<Vector3f> points{root.at_mm};
  Vector3f direction = hair.direction;
  Vector3f normal = root.frame.col(2);
  const float step_mm = hair.length_mm / static_cast<float>(hair.points - 1);
  for (int p = 1; p < hair.points; ++p) {
    const float part = static_cast<float>(p) / static_cast<float>(hair.points - 1);
    direction -= direction.dot(normal) * normal;
    if (direction.norm() < 1e-3F) {
      return;
    }
    direction.normalize();
    const Vector3f ahead = points.back() + step_mm * direction;
    const render::Raycaster::Closest closest = surface_.closest_point(ahead, 8);
    if (closest.triangle < 0) {
      break;
    }
    normal = skin_frame(scalp_.vertices_mm, scalp_.normals, scalp_.triangles, closest.triangle,
                        closest.barycentric)
                 .col(2);
    const float off_mm = std::min(hair.rise * hair.length_mm * part, hair.top_mm * (0.4F + 0.6F * part));
    points.push_back(closest.point_mm + off_mm * normal);
  }
  if (points.size() >= 2) {
    const float shade = random_.uniform(0.65F, 1.35F);
    add(root, points, hair.radius_mm, shade * person_.complexion.hair);
  }
}

void Barber::add(const Root& root, const std::vector<Vector3f>& points, float radius_mm,
                 const Vector3f& albedo) {
  constexpr float kTip = 0.35F;  // of the root's radius
  strands_.triangle.push_back(root.triangle);
  strands_.barycentric.push_back(root.barycentric);
  strands_.albedo.push_back(albedo.cwiseMin(0.9F));
  for (std::size_t p = 0; p < points.size(); ++p) {
    const float part = static_cast<float>(p) / static_cast<float>(points.size() - 1);
    strands_.local_mm.emplace_back(root.frame.transpose() * (points[p] - root.at_mm));
    strands_.radius_mm.push_back(radius_mm * (1 - (1 - kTip) * part * part));
  }
  strands_.first.push_back(static_cast<std::int32_t>(strands_.local_mm.size()));
}

template <typename Density, typename Grow>
void Barber::scatter(int count, const Density& density, const Grow& grow) {
  const mesh::Triangles& triangles = scalp_.triangles;
  Eigen::VectorXf weights(scalp_.vertices_mm.cols());
  for (Eigen::Index v = 0; v < weights.size(); ++v) {
    weights[v] = density(v);
  }
  std::vector<double> sums{0};
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const Vector3f a = scalp_.vertices_mm.col(triangles(0, t));
    const Vector3f b = scalp_.vertices_mm.col(triangles(1, t));
    const Vector3f c = scalp_.vertices_mm.col(triangles(2, t));
    const float weight = weights[triangles(0, t)] + weights[triangles(1, t)] + weights[triangles(2, t)];
    sums.push_back(sums.back() + static_cast<double>((b - a).cross(c - a).norm() * weight));
  }
  if (sums.back() <= 0) {
    return;
  }
  for (int k = 0; k < count; ++k) {
    // One in each of count equal parts of the whole: no bare patches by chance.
    const double pick =
        (static_cast<double>(k) + static_cast<double>(random_.uniform())) / count * sums.back();
    const auto t =
        static_cast<Eigen::Index>(std::upper_bound(sums.begin(), sums.end(), pick) - sums.begin()) - 1;
    const auto corners = triangles.col(std::clamp<Eigen::Index>(t, 0, triangles.cols() - 1));
    float u = random_.uniform();
    float v = random_.uniform();
    if (u + v > 1) {
      u = 1 - u;
      v = 1 - v;
    }
    nearest_hair_ = scalp_.hair[corners[0]];
    grow(Vector3f((1 - u - v) * scalp_.vertices_mm.col(corners[0]) + u * scalp_.vertices_mm.col(corners[1]) +
                  v * scalp_.vertices_mm.col(corners[2])));
  }
}

}  // namespace

Eigen::VectorXf lip_cover(const std::vector<Eigen::Vector3f>& outline, const mesh::Vertices& resting_mm) {
  constexpr float kSoft_mm = 1.0F;
  constexpr float kDepth_mm = 14;  // behind the outline's frontmost point begins the mouth
  Eigen::VectorXf cover = Eigen::VectorXf::Zero(resting_mm.cols());
  if (outline.size() < 3) {
    return cover;
  }
  float front_mm = outline[0].z();
  for (const Vector3f& point : outline) {
    front_mm = std::max(front_mm, point.z());
  }
  for (Eigen::Index v = 0; v < resting_mm.cols(); ++v) {
    const Vector2f at = resting_mm.col(v).head<2>();
    // Seen from in front: the nearest edge's distance, and whether a ray to one side crosses an odd number.
    float nearest_mm = 1e6F;
    bool inside = false;
    for (std::size_t k = 0; k < outline.size(); ++k) {
      const Vector2f a = outline[k].head<2>();
      const Vector2f b = outline[(k + 1) % outline.size()].head<2>();
      const Vector2f edge = b - a;
      const float part = std::clamp((at - a).dot(edge) / std::max(edge.squaredNorm(), 1e-6F), 0.0F, 1.0F);
      nearest_mm = std::min(nearest_mm, (at - a - part * edge).norm());
      if ((a.y() > at.y()) != (b.y() > at.y()) &&
          at.x() < a.x() + (at.y() - a.y()) / (b.y() - a.y()) * edge.x()) {
        inside = !inside;
      }
    }
    const float in_mm = inside ? nearest_mm : -nearest_mm;
    cover[v] = smooth_step(-kSoft_mm, kSoft_mm, in_mm) *
               smooth_step(front_mm - 1.6F * kDepth_mm, front_mm - kDepth_mm, resting_mm(2, v));
  }
  return cover;
}

FaceLines find_face_lines(const face::FaceModel& model, const mesh::Vertices& neutral_mm) {
  // Numbers of MediaPipe's face mesh; the subject's right, then left.
  static constexpr std::array<std::array<int, 9>, 2> kUpper{
      {{133, 173, 157, 158, 159, 160, 161, 246, 33}, {362, 398, 384, 385, 386, 387, 388, 466, 263}}};
  static constexpr std::array<std::array<int, 9>, 2> kLower{
      {{133, 155, 154, 153, 145, 144, 163, 7, 33}, {362, 382, 381, 380, 374, 373, 390, 249, 263}}};
  static constexpr std::array<std::array<int, 5>, 2> kBrowUpper{
      {{107, 66, 105, 63, 70}, {336, 296, 334, 293, 300}}};
  static constexpr std::array<std::array<int, 5>, 2> kBrowLower{
      {{55, 65, 52, 53, 46}, {285, 295, 282, 283, 276}}};
  const auto line = [&](const auto& numbers) {
    std::vector<Vector3f> points;
    for (const int number : numbers) {
      const face::LandmarkAnchor& anchor = model.landmarks.at(static_cast<std::size_t>(number));
      if (anchor.weights[0] != 0 || anchor.weights[1] != 0 || anchor.weights[2] != 0) {
        points.push_back(face::FaceModel::anchor_point(anchor, neutral_mm));
      }
    }
    return points;
  };
  static constexpr std::array<int, 20> kLips{61,  185, 40,  39,  37,  0,  267, 269, 270, 409,
                                             291, 375, 321, 405, 314, 17, 84,  181, 91,  146};
  FaceLines lines;
  lines.lips = line(kLips);
  for (std::size_t side = 0; side < 2; ++side) {
    lines.lid_upper.at(side) = line(kUpper.at(side));
    lines.lid_lower.at(side) = line(kLower.at(side));
    lines.brow_upper.at(side) = line(kBrowUpper.at(side));
    lines.brow_lower.at(side) = line(kBrowLower.at(side));
  }
  return lines;
}

HairStrands grow_strands(const Scalp& scalp, const Anatomy& anatomy, const FaceLines& lines,
                         const Person& person, std::uint64_t seed) {
  Barber barber(scalp, anatomy, person, seed);
  for (std::size_t side = 0; side < 2; ++side) {
    barber.grow_brow(side, lines.brow_upper.at(side), lines.brow_lower.at(side));
    const Vector3f eye_mm = 0.5F * (anatomy.eye_outer.at(side) + anatomy.eye_inner.at(side));
    barber.grow_lashes(lines.lid_upper.at(side), eye_mm, true);
    barber.grow_lashes(lines.lid_lower.at(side), eye_mm, false);
  }
  barber.grow_beard();
  barber.grow_head();
  return barber.take();
}

render::Strands place_strands(const HairStrands& hair, const mesh::Vertices& vertices_mm,
                              const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles) {
  render::Strands placed;
  placed.points.resize(4, static_cast<Eigen::Index>(hair.local_mm.size()));
  placed.segments.reserve(hair.local_mm.size());
  for (std::size_t k = 0; k < hair.count(); ++k) {
    const Eigen::Matrix3f frame =
        skin_frame(vertices_mm, normals, triangles, hair.triangle[k], hair.barycentric[k]);
    const Vector3f root = render::interpolate(triangles, hair.triangle[k], hair.barycentric[k], vertices_mm);
    for (auto p = static_cast<std::size_t>(hair.first[k]); p < static_cast<std::size_t>(hair.first[k + 1]);
         ++p) {
      const Vector3f at = root + frame * hair.local_mm[p];
      placed.points.col(static_cast<Eigen::Index>(p)) << at, hair.radius_mm[p];
      if (p + 1 < static_cast<std::size_t>(hair.first[k + 1])) {
        placed.segments.push_back(static_cast<std::uint32_t>(p));
      }
    }
  }
  return placed;
}

}  // namespace facet::simulation
