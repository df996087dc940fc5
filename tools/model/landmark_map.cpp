#include "model/landmark_map.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <set>
#include <string_view>

#include "facet/error.hpp"
#include "model/portrait.hpp"

namespace facet::model {
namespace {

using face::FaceModel;
using face::LandmarkAnchor;
using face::Region;

constexpr int kPictureSize = 640;
constexpr float kPictureFieldMm =
    330;  // leaves the margin around the face that the detector was trained with

// MediaPipe's lip contours without their corners (61, 291 outer and 78, 308 inner).
const std::set<int> kUpperLip = {185, 40, 39, 37, 0,  267, 269, 270, 409,
                                 191, 80, 81, 82, 13, 312, 311, 310, 415};
const std::set<int> kLowerLip = {146, 91, 181, 84, 17, 314, 405, 321, 375,
                                 95,  88, 178, 87, 14, 317, 402, 318, 324};
const std::set<int> kInnerLips = {78,  95,  88, 178, 87, 14, 317, 402, 318, 324,
                                  308, 191, 80, 81,  82, 13, 312, 311, 310, 415};

/// A picture to take: expression weights by name and a point of view.
struct Pose {
  std::string name;
  std::vector<std::pair<const char*, float>> expression;
  float yaw_rad = 0;
  float pitch_rad = 0;
  bool inner_lips = false;  // this pose places the inner lips, the others all else
};

const std::vector<Pose>& placing_poses() {
  static const std::vector<Pose> kPoses = {
      {"neutral", {}, 0, 0, false},
      {"turned left", {}, 0.3F, 0, false},
      {"turned right", {}, -0.3F, 0, false},
      {"from above", {}, 0, 0.18F, false},
      {"from below", {}, 0, -0.18F, false},
      {"mouth open", {{"jawOpen", 0.35F}}, 0, 0, true},
      {"mouth open, left", {{"jawOpen", 0.35F}}, 0.2F, 0, true},
      {"mouth open, right", {{"jawOpen", 0.35F}}, -0.2F, 0, true},
  };
  return kPoses;
}

const std::vector<Pose>& checking_poses() {
  static const std::vector<Pose> kPoses = {
      {"neutral", {}, 0, 0, false},
      {"turned left", {}, 0.5F, 0, false},
      {"jawOpen 0.6", {{"jawOpen", 0.6F}}, 0, 0, false},
      {"smile 0.8", {{"mouthSmileLeft", 0.8F}, {"mouthSmileRight", 0.8F}}, 0, 0, false},
      {"blink 1.0", {{"eyeBlinkLeft", 1.0F}, {"eyeBlinkRight", 1.0F}}, 0, 0, false},
      {"browInnerUp 0.8",
       {{"browInnerUp", 0.8F}, {"browOuterUpLeft", 0.6F}, {"browOuterUpRight", 0.6F}},
       0,
       0,
       false},
      {"browDown 0.8", {{"browDownLeft", 0.8F}, {"browDownRight", 0.8F}}, 0, 0, false},
      {"mouthPucker 0.8", {{"mouthPucker", 0.8F}}, 0, 0, false},
      {"mouthFunnel 0.8", {{"mouthFunnel", 0.8F}}, 0, 0, false},
      {"mouthLeft 1.0", {{"mouthLeft", 1.0F}}, 0, 0, false},
      {"jaw open, closed lips", {{"jawOpen", 0.4F}, {"mouthClose", 0.4F}}, 0, 0, false},
      {"lips parted",
       {{"mouthLowerDownLeft", 0.7F},
        {"mouthLowerDownRight", 0.7F},
        {"mouthUpperUpLeft", 0.7F},
        {"mouthUpperUpRight", 0.7F}},
       0,
       0,
       false},
  };
  return kPoses;
}

mesh::Vertices pose_vertices_mm(const FaceModel& model, const Pose& pose) {
  std::vector<float> weights(static_cast<std::size_t>(model.expression_count()), 0.0F);
  for (const auto& [name, weight] : pose.expression) {
    if (const int index = model.expression_index(name); index >= 0) {
      weights[static_cast<std::size_t>(index)] = weight;
    }
  }
  mesh::Vertices vertices_mm;
  model.evaluate({}, weights, vertices_mm);
  return vertices_mm;
}

/// The picture frames the face alike on any model: centred on its frontal skin.
View pose_view(const FaceModel& model, const Pose& pose, int size_px) {
  const auto mean_mm = model.core_row(0, 0);
  Eigen::Vector3f low = Eigen::Vector3f::Constant(std::numeric_limits<float>::max());
  Eigen::Vector3f high = -low;
  for (Eigen::Index v = 0; v < mean_mm.cols(); ++v) {
    if (face::has_region(model.regions[static_cast<std::size_t>(v)], Region::Refinable)) {
      low = low.cwiseMin(mean_mm.col(v));
      high = high.cwiseMax(mean_mm.col(v));
    }
  }
  View view;
  view.size_px = size_px;
  view.field_mm = kPictureFieldMm;
  view.yaw_rad = pose.yaw_rad;
  view.pitch_rad = pose.pitch_rad;
  view.target_mm = 0.5F * (low + high);
  return view;
}

/// Which triangles a landmark may lie on.
enum class Side { Any, Upper, Lower };

Side side_of(int landmark) {
  return kUpperLip.count(landmark) != 0   ? Side::Upper
         : kLowerLip.count(landmark) != 0 ? Side::Lower
                                          : Side::Any;
}

/// The skin's triangles, and those that the upper and the lower lip may be looked for on.
class SkinSurfaces {
 public:
  explicit SkinSurfaces(const FaceModel& model) {
    constexpr float kUpperMost = 0.4F;  // of the largest jaw drop: more than that is no upper lip
    constexpr float kLowerLeast = 0.2F;
    const int jaw = model.expression_index("jawOpen");
    Eigen::VectorXf drop = Eigen::VectorXf::Zero(model.vertex_count());
    if (jaw >= 0) {
      drop = -model.core_row(0, jaw + 1).row(1).transpose();
      drop /= std::max(drop.maxCoeff(), 1e-3F);
    }
    const mesh::Triangles all = model_triangles(model);
    for (const Side side : {Side::Any, Side::Upper, Side::Lower}) {
      std::vector<Eigen::Index> kept;
      for (Eigen::Index t = 0; t < all.cols(); ++t) {
        bool allowed = true;
        for (int corner = 0; corner < 3; ++corner) {
          const int v = all(corner, t);
          const std::uint8_t bits = model.regions[static_cast<std::size_t>(v)];
          allowed = allowed && !face::has_region(bits, Region::Eye) &&
                    !face::has_region(bits, Region::MouthInterior);
          if (jaw >= 0) {
            allowed = allowed && (side != Side::Upper || drop[v] < kUpperMost) &&
                      (side != Side::Lower || drop[v] > kLowerLeast);
          }
        }
        if (allowed) {
          kept.push_back(t);
        }
      }
      mesh::Triangles& triangles = triangles_[static_cast<std::size_t>(side)];
      triangles.resize(3, static_cast<Eigen::Index>(kept.size()));
      for (std::size_t k = 0; k < kept.size(); ++k) {
        triangles.col(static_cast<Eigen::Index>(k)) = all.col(kept[k]);
      }
    }
  }
  const mesh::Triangles& triangles(Side side) const { return triangles_[static_cast<std::size_t>(side)]; }

 private:
  std::array<mesh::Triangles, 3> triangles_;
};

LandmarkAnchor make_anchor(const mesh::Triangles& triangles, std::int32_t triangle,
                           const Eigen::Vector2f& barycentric) {
  LandmarkAnchor anchor;
  for (int corner = 0; corner < 3; ++corner) {
    anchor.vertices[static_cast<std::size_t>(corner)] = triangles(corner, triangle);
  }
  const float b = std::clamp(barycentric.x(), 0.0F, 1.0F);
  const float c = std::clamp(barycentric.y(), 0.0F, 1.0F - b);
  anchor.weights = {1 - b - c, b, c};
  return anchor;
}

/// The point of a surface nearest to a ray from the origin: coarse search along it, then alternating
/// projections.
std::optional<LandmarkAnchor> nearest_to_ray(const render::Raycaster& caster,
                                             const mesh::Triangles& triangles,
                                             const Eigen::Vector3f& direction, float depth_mm) {
  constexpr float kSearchMm = 150;  // before and behind the picture's target
  constexpr float kStepMm = 5;
  constexpr int kSteps = static_cast<int>(2 * kSearchMm / kStepMm);
  constexpr float kReachMm = 40;  // a landmark farther from the surface is no landmark of this face
  constexpr int kProjections = 25;
  float best_mm = kReachMm;
  float best_along_mm = 0;
  for (int step = 0; step < kSteps; ++step) {
    const float along_mm = depth_mm - kSearchMm + static_cast<float>(step) * kStepMm;
    const auto closest = caster.closest_point(along_mm * direction, best_mm);
    if (closest.triangle >= 0 && closest.distance_mm < best_mm) {
      best_mm = closest.distance_mm;
      best_along_mm = along_mm;
    }
  }
  if (best_mm >= kReachMm) {
    return std::nullopt;
  }
  render::Raycaster::Closest closest;
  for (int k = 0; k < kProjections; ++k) {
    closest = caster.closest_point(best_along_mm * direction, kReachMm);
    best_along_mm = closest.point_mm.dot(direction);
  }
  return make_anchor(triangles, closest.triangle, closest.barycentric);
}

landmark::FaceLandmarks detect(landmark::Landmarker& landmarker, const render::Picture& picture,
                               const std::string& pose) {
  auto faces = landmarker.find_all(render::to_frame(picture));
  if (faces.empty()) {
    throw Error(ErrorKind::NoFace,
                fmt::format("the landmark net finds no face in the render '{}' of the model; look at "
                            "it with `facet model show`",
                            pose));
  }
  return std::move(faces.front());
}

/// The landmark on the other side of the face, by MediaPipe's canonical face.
std::vector<int> landmark_mirror(const landmark::CanonicalFace& canonical) {
  std::vector<int> mirror;
  for (int i = 0; i < FaceModel::kLandmarkCount; ++i) {
    const Eigen::Vector3f wanted = canonical.vertices_cm.col(i).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
    Eigen::Index nearest = 0;
    (canonical.vertices_cm.colwise() - wanted).colwise().squaredNorm().minCoeff(&nearest);
    mirror.push_back(static_cast<int>(nearest));
  }
  return mirror;
}

Eigen::Vector2f project(const CameraIntrinsics& camera, const Eigen::Vector3f& point_mm) {
  return {camera.fx * point_mm.x() / point_mm.z() + camera.cx,
          camera.fy * point_mm.y() / point_mm.z() + camera.cy};
}

/// Adds what one pose tells about the landmarks: positions on the mean face, weighted by how squarely they
/// are seen.
void place_from_pose(const FaceModel& model, const PortraitRenderer& renderer, const SkinSurfaces& surfaces,
                     landmark::Landmarker& landmarker, const Pose& pose, mesh::Vertices& sums_mm,
                     Eigen::VectorXf& weights) {
  const View view = pose_view(model, pose, kPictureSize);
  const CameraIntrinsics camera = view.camera();
  const mesh::Vertices vertices_mm = pose_vertices_mm(model, pose);
  const landmark::FaceLandmarks found =
      detect(landmarker, renderer.render(vertices_mm, view, Style::Lifelike), pose.name);
  const Eigen::Isometry3f camera_from_head = view.camera_from_head();
  const mesh::Vertices camera_mm =
      (camera_from_head.linear() * vertices_mm).colwise() + camera_from_head.translation();
  const mesh::Vertices mean_mm = model.core_row(0, 0);
  const std::array<render::Raycaster, 3> casters = {
      render::Raycaster(camera_mm, surfaces.triangles(Side::Any)),
      render::Raycaster(camera_mm, surfaces.triangles(Side::Upper)),
      render::Raycaster(camera_mm, surfaces.triangles(Side::Lower))};
  for (int i = 0; i < FaceModel::kLandmarkCount; ++i) {
    if ((kInnerLips.count(i) != 0) != pose.inner_lips) {
      continue;
    }
    const Side side = side_of(i);
    const render::Raycaster& caster = casters[static_cast<std::size_t>(side)];
    const mesh::Triangles& triangles = surfaces.triangles(side);
    const Eigen::Vector3f direction = Eigen::Vector3f((found.points_px(0, i) - camera.cx) / camera.fx,
                                                      (found.points_px(1, i) - camera.cy) / camera.fy, 1)
                                          .normalized();
    const auto hit = caster.first_hit(Eigen::Vector3f::Zero(), direction, 0, true);
    std::optional<LandmarkAnchor> anchor;
    float facing = 0.2F;  // a ray that misses touches the surface at its outline
    if (hit.triangle >= 0) {
      anchor = make_anchor(triangles, hit.triangle, hit.barycentric);
      const auto corner = [&](int k) { return Eigen::Vector3f(camera_mm.col(triangles(k, hit.triangle))); };
      const Eigen::Vector3f normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
      facing = std::max(facing, std::abs(normal.dot(direction)));
    } else {
      anchor = nearest_to_ray(caster, triangles, direction, view.distance_mm);
    }
    if (anchor) {
      const float weight = facing * facing * std::max(found.confidence[i], 1e-3F);
      sums_mm.col(i) += weight * FaceModel::anchor_point(*anchor, mean_mm);
      weights[i] += weight;
    }
  }
}

}  // namespace

std::vector<LandmarkAnchor> find_landmarks(const FaceModel& model, landmark::Landmarker& landmarker,
                                           const LandmarkProgress& progress) {
  const PortraitRenderer renderer(model);
  const SkinSurfaces surfaces(model);
  mesh::Vertices sums_mm = mesh::Vertices::Zero(3, FaceModel::kLandmarkCount);
  Eigen::VectorXf weights = Eigen::VectorXf::Zero(FaceModel::kLandmarkCount);
  int done = 0;
  for (const Pose& pose : placing_poses()) {
    place_from_pose(model, renderer, surfaces, landmarker, pose, sums_mm, weights);
    progress(++done, static_cast<int>(placing_poses().size()));
  }

  const mesh::Vertices mean_mm = model.core_row(0, 0);
  const std::array<render::Raycaster, 3> casters = {
      render::Raycaster(mean_mm, surfaces.triangles(Side::Any)),
      render::Raycaster(mean_mm, surfaces.triangles(Side::Upper)),
      render::Raycaster(mean_mm, surfaces.triangles(Side::Lower))};
  const std::vector<int> mirror = landmark_mirror(landmarker.canonical());
  std::vector<LandmarkAnchor> anchors(FaceModel::kLandmarkCount);
  for (int i = 0; i < FaceModel::kLandmarkCount; ++i) {
    const int twin = mirror[static_cast<std::size_t>(i)];
    if (weights[i] + weights[twin] <= 0) {
      continue;
    }
    const Eigen::Vector3f both_mm =
        sums_mm.col(i) + sums_mm.col(twin).cwiseProduct(Eigen::Vector3f(-1, 1, 1));
    const Eigen::Vector3f point_mm = both_mm / (weights[i] + weights[twin]);
    constexpr float kReachMm = 60;
    const Side side = side_of(i);
    const auto closest = casters[static_cast<std::size_t>(side)].closest_point(point_mm, kReachMm);
    if (closest.triangle >= 0) {
      anchors[static_cast<std::size_t>(i)] =
          make_anchor(surfaces.triangles(side), closest.triangle, closest.barycentric);
    }
  }
  return anchors;
}

std::vector<LandmarkAgreement> check_landmarks(const FaceModel& model, landmark::Landmarker& landmarker,
                                               const LandmarkProgress& progress) {
  const PortraitRenderer renderer(model);
  std::vector<LandmarkAgreement> agreements;
  for (const Pose& pose : checking_poses()) {
    LandmarkAgreement& agreement = agreements.emplace_back();
    agreement.pose = pose.name;
    const View view = pose_view(model, pose, kPictureSize);
    const mesh::Vertices vertices_mm = pose_vertices_mm(model, pose);
    const auto faces =
        landmarker.find_all(render::to_frame(renderer.render(vertices_mm, view, Style::Lifelike)));
    progress(static_cast<int>(agreements.size()), static_cast<int>(checking_poses().size()));
    if (faces.empty()) {
      continue;
    }
    agreement.found = true;
    const Eigen::Isometry3f camera_from_head = view.camera_from_head();
    std::array<int, landmark::kLandmarkGroupCount> count{};
    for (int i = 0; i < FaceModel::kLandmarkCount; ++i) {
      const Eigen::Vector3f anchor_mm =
          camera_from_head *
          FaceModel::anchor_point(model.landmarks[static_cast<std::size_t>(i)], vertices_mm);
      const float distance_px =
          (project(view.camera(), anchor_mm) - faces.front().points_px.col(i).head<2>()).norm();
      const auto group = static_cast<std::size_t>(landmark::landmark_groups()[static_cast<std::size_t>(i)]);
      agreement.mean_mm[group] += distance_px * anchor_mm.z() / view.camera().fx;
      ++count[group];
    }
    for (std::size_t group = 0; group < count.size(); ++group) {
      agreement.mean_mm[group] /= static_cast<float>(std::max(1, count[group]));
    }
  }
  return agreements;
}

render::Picture landmark_sheet(const FaceModel& model, landmark::Landmarker& landmarker, int tile_px) {
  constexpr std::array<std::uint8_t, 3> kAnchorColour = {40, 255, 90};
  constexpr std::array<std::uint8_t, 3> kNetColour = {255, 50, 40};
  constexpr int kColumns = 4;
  const PortraitRenderer renderer(model);
  const int count = static_cast<int>(checking_poses().size());
  render::Picture sheet =
      render::plain_picture(kColumns * tile_px, (count + kColumns - 1) / kColumns * tile_px, {0, 0, 0});
  for (int k = 0; k < count; ++k) {
    const Pose& pose = checking_poses()[static_cast<std::size_t>(k)];
    const View view = pose_view(model, pose, kPictureSize);
    const mesh::Vertices vertices_mm = pose_vertices_mm(model, pose);
    const render::Picture small = renderer.render(vertices_mm, view, Style::Lifelike);
    const auto faces = landmarker.find_all(render::to_frame(small));
    // Drawn larger than it is looked at, and closer.
    View close = view;
    close.size_px = tile_px;
    close.field_mm = 0.72F * view.field_mm;
    render::Picture picture = renderer.render(vertices_mm, close, Style::Lifelike);
    const float scale = close.camera().fx / view.camera().fx;
    const float radius_px = std::max(1.0F, static_cast<float>(tile_px) / 500.0F);
    for (int i = 0; i < FaceModel::kLandmarkCount; ++i) {
      const Eigen::Vector2f centre_px(close.camera().cx, close.camera().cy);
      const Eigen::Vector3f anchor_mm =
          close.camera_from_head() *
          FaceModel::anchor_point(model.landmarks[static_cast<std::size_t>(i)], vertices_mm);
      const Eigen::Vector2f anchor_px = project(close.camera(), anchor_mm);
      if (!faces.empty()) {
        const Eigen::Vector2f from_centre_px =
            faces.front().points_px.col(i).head<2>() - Eigen::Vector2f(view.camera().cx, view.camera().cy);
        const Eigen::Vector2f net_px = centre_px + scale * from_centre_px;
        render::draw_line(picture, anchor_px, net_px, kNetColour);
        render::draw_dot(picture, net_px, radius_px, kNetColour);
      }
      render::draw_dot(picture, anchor_px, radius_px, kAnchorColour);
    }
    render::draw_text(picture, 4, 4, pose.name + (faces.empty() ? " (no face found)" : ""), {255, 255, 0});
    render::paste(sheet, picture, k % kColumns * tile_px, k / kColumns * tile_px);
  }
  return sheet;
}

}  // namespace facet::model
