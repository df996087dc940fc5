#include "face/face_parts.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <span>

namespace facet::face {
namespace {

using Eigen::Vector2f;
using Outline = std::vector<Vector2f>;

// Landmarks of MediaPipe's face mesh; the subject's right side first where there are two.
constexpr std::array kLips{61,  146, 91,  181, 84,  17, 314, 405, 321, 375,
                           291, 409, 270, 269, 267, 0,  37,  39,  40,  185};
constexpr std::array kRightEye{33, 7, 163, 144, 145, 153, 154, 155, 133, 173, 157, 158, 159, 160, 161, 246};
constexpr std::array kLeftEye{263, 249, 390, 373, 374, 380, 381, 382, 362, 398, 384, 385, 386, 387, 388, 466};
constexpr std::array kRightBrow{46, 53, 52, 65, 55, 107, 66, 105, 63, 70};
constexpr std::array kLeftBrow{276, 283, 282, 295, 285, 336, 296, 334, 293, 300};
constexpr std::array kNose{193, 129, 98, 2, 327, 358, 417};
/// From the right temple over the lower edges of the brows to the left one.
constexpr std::array kBrowLine{162, 46, 55, 8, 285, 276, 389};
/// From the jaw's right angle over the corners of the mouth to the left one.
constexpr std::array kMouthLine{58, 61, 291, 288};

Vector2f seen_from_the_front(const FaceModel& model, const mesh::Vertices& mean_mm, int landmark) {
  return FaceModel::anchor_point(model.landmarks[static_cast<std::size_t>(landmark)], mean_mm).head<2>();
}

Outline outline(const FaceModel& model, const mesh::Vertices& mean_mm, std::span<const int> landmarks) {
  Outline points;
  for (const int landmark : landmarks) {
    points.push_back(seen_from_the_front(model, mean_mm, landmark));
  }
  return points;
}

float distance_to_edge(const Vector2f& a, const Vector2f& b, const Vector2f& point) {
  const Vector2f edge = b - a;
  const float length2 = edge.squaredNorm();
  const float along = length2 > 0 ? std::clamp((point - a).dot(edge) / length2, 0.0F, 1.0F) : 0.0F;
  return (a + along * edge - point).norm();
}

/// Distance to a closed outline, mm; 0 inside of it.
float distance_to(const Outline& outline, const Vector2f& point) {
  bool is_inside = false;
  float nearest = std::numeric_limits<float>::max();
  for (std::size_t k = 0; k < outline.size(); ++k) {
    const Vector2f& a = outline[k];
    const Vector2f& b = outline[(k + 1) % outline.size()];
    nearest = std::min(nearest, distance_to_edge(a, b, point));
    if ((a.y() > point.y()) != (b.y() > point.y()) &&
        point.x() < a.x() + (b.x() - a.x()) * (point.y() - a.y()) / (b.y() - a.y())) {
      is_inside = !is_inside;
    }
  }
  return is_inside ? 0 : nearest;
}

/// Height of an open line at x, continued level beyond its ends.
float height_at(Outline line, float x) {
  std::sort(line.begin(), line.end(), [](const Vector2f& a, const Vector2f& b) { return a.x() < b.x(); });
  if (x <= line.front().x()) {
    return line.front().y();
  }
  for (std::size_t k = 0; k + 1 < line.size(); ++k) {
    if (x <= line[k + 1].x()) {
      const float along = (x - line[k].x()) / std::max(line[k + 1].x() - line[k].x(), 1e-6F);
      return line[k].y() + along * (line[k + 1].y() - line[k].y());
    }
  }
  return line.back().y();
}

}  // namespace

std::vector<FacePart> control_parts(const FaceModel& model) {
  const mesh::Vertices mean_mm = model.core_row(0, 0);
  const auto of = [&](std::span<const int> landmarks) { return outline(model, mean_mm, landmarks); };
  const Outline nose = of(kNose);
  const Outline lips = of(kLips);
  const std::array brows{of(kRightBrow), of(kLeftBrow)};
  const std::array eyes{of(kRightEye), of(kLeftEye)};
  const Outline brow_line = of(kBrowLine);
  const Outline mouth_line = of(kMouthLine);
  constexpr float kAroundLips_mm = 7;
  constexpr float kAroundBrows_mm = 4;
  constexpr float kAroundEyes_mm = 9;
  const auto part_of = [&](const Vector2f& point) {
    const auto is_near = [&](const std::array<Outline, 2>& two, float mm) {
      return std::min(distance_to(two[0], point), distance_to(two[1], point)) <= mm;
    };
    if (distance_to(nose, point) <= 0) {
      return FacePart::Nose;
    }
    if (distance_to(lips, point) <= kAroundLips_mm) {
      return FacePart::Mouth;
    }
    if (is_near(brows, kAroundBrows_mm)) {
      return FacePart::Brows;
    }
    if (is_near(eyes, kAroundEyes_mm)) {
      return FacePart::Lids;
    }
    if (point.y() > height_at(brow_line, point.x())) {
      return FacePart::Forehead;
    }
    return point.y() < height_at(mouth_line, point.x()) ? FacePart::ChinAndJaw : FacePart::Cheeks;
  };
  std::vector<FacePart> parts;
  for (Eigen::Index v = 0; v < mean_mm.cols(); ++v) {
    parts.push_back(part_of(mean_mm.col(v).head<2>()));
  }
  return parts;
}

std::vector<float> shading_trust(const FaceModel& model) {
  const mesh::Vertices mean_mm = model.core_row(0, 0);
  std::vector<float> trust(static_cast<std::size_t>(mean_mm.cols()), 1);
  if (model.landmarks.empty()) {
    return trust;
  }
  constexpr float kHair_mm = 4;
  constexpr float kSkin_mm = 10;
  for (const std::span<const int> brow :
       {std::span<const int>(kRightBrow), std::span<const int>(kLeftBrow)}) {
    const Outline around = outline(model, mean_mm, brow);
    for (std::size_t v = 0; v < trust.size(); ++v) {
      const float distance_mm = distance_to(around, mean_mm.col(static_cast<Eigen::Index>(v)).head<2>());
      trust[v] = std::min(trust[v], std::clamp((distance_mm - kHair_mm) / (kSkin_mm - kHair_mm), 0.0F, 1.0F));
    }
  }
  return trust;
}

std::vector<FacePart> finest_parts(const mesh::Hierarchy& hierarchy,
                                   const std::vector<FacePart>& control_parts) {
  Eigen::MatrixXf shares = Eigen::MatrixXf::Zero(static_cast<Eigen::Index>(kFacePartNames.size()),
                                                 static_cast<Eigen::Index>(control_parts.size()));
  for (std::size_t v = 0; v < control_parts.size(); ++v) {
    shares(static_cast<Eigen::Index>(control_parts[v]), static_cast<Eigen::Index>(v)) = 1;
  }
  Eigen::MatrixXf finer;
  for (const mesh::Level& level : hierarchy.levels) {
    mesh::apply(level.from_coarser, shares, finer);
    shares.swap(finer);
  }
  std::vector<FacePart> parts(static_cast<std::size_t>(shares.cols()));
  for (Eigen::Index v = 0; v < shares.cols(); ++v) {
    Eigen::Index largest = 0;
    shares.col(v).maxCoeff(&largest);
    parts[static_cast<std::size_t>(v)] = static_cast<FacePart>(largest);
  }
  return parts;
}

}  // namespace facet::face
