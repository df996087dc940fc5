#include "booth/face_points.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <limits>
#include <optional>

#include "files/text_file.hpp"
#include "files/toml_section.hpp"

namespace facet::booth {
namespace {

using files::TomlSection;

constexpr Eigen::Index kLandmarks = 468;
constexpr double kFarthest_px = 1e5;

struct NamedLandmark {
  std::string_view name;
  Eigen::Index index;  ///< MediaPipe's
};
/// Left and right are the person's own.
constexpr std::array kNamed = {
    NamedLandmark{"right_eye_outer", 33},
    NamedLandmark{"right_eye_inner", 133},
    NamedLandmark{"left_eye_inner", 362},
    NamedLandmark{"left_eye_outer", 263},
    NamedLandmark{"right_brow_outer", 46},
    NamedLandmark{"right_brow_inner", 55},
    NamedLandmark{"left_brow_inner", 285},
    NamedLandmark{"left_brow_outer", 276},
    NamedLandmark{"nose_bridge", 168},
    NamedLandmark{"nose_tip", 1},
    NamedLandmark{"right_nostril", 129},
    NamedLandmark{"left_nostril", 358},
    NamedLandmark{"mouth_right", 61},
    NamedLandmark{"mouth_left", 291},
    NamedLandmark{"lip_top", 0},
    NamedLandmark{"lip_bottom", 17},
    NamedLandmark{"chin", 152},
};

/// A landmark by its name or its number; nothing where there is none of that.
std::optional<Eigen::Index> landmark_of(std::string_view key) {
  const auto named = std::find_if(kNamed.begin(), kNamed.end(),
                                  [&](const NamedLandmark& landmark) { return landmark.name == key; });
  if (named != kNamed.end()) {
    return named->index;
  }
  if (key.empty() || key.size() > 3 || key.find_first_not_of("0123456789") != std::string_view::npos) {
    return std::nullopt;
  }
  Eigen::Index number = 0;
  for (const char digit : key) {
    number = 10 * number + (digit - '0');
  }
  return number < kLandmarks ? std::optional(number) : std::nullopt;
}

FacePoints::Camera read_camera(TomlSection section, const std::string& name) {
  FacePoints::Camera camera;
  camera.name = name;
  camera.face.points_px = Eigen::Matrix3Xf::Zero(3, kLandmarks);
  camera.face.confidence = Eigen::VectorXf::Zero(kLandmarks);
  for (const auto& [key, node] : section.entries()) {
    const std::optional<Eigen::Index> landmark = landmark_of(key);
    if (!landmark) {
      std::string names;
      for (const NamedLandmark& one : kNamed) {
        names += fmt::format("{}, ", one.name);
      }
      section.fail(node, key,
                   fmt::format("is no landmark: {}or a number from 0 to {}", names, kLandmarks - 1));
    }
    if (camera.face.confidence[*landmark] > 0) {
      section.fail(node, key, fmt::format("is landmark {}, which has a place already", *landmark));
    }
    std::array<double, 2> at_px{};
    section.read_numbers(key, at_px, -kFarthest_px, kFarthest_px);
    camera.face.points_px.col(*landmark).head<2>() = Eigen::Vector2d(at_px[0], at_px[1]).cast<float>();
    camera.face.confidence[*landmark] = 1;
  }
  section.finish();
  return camera;
}

void read_all(files::TomlDocument& document, FacePoints& points) {
  TomlSection root(document, &document.root(), "");
  constexpr std::array kNeeded = {"slot"};
  root.require(kNeeded);
  root.read_integer("slot", points.slot, 0, std::numeric_limits<std::int64_t>::max());
  TomlSection cameras = root.section("camera");
  for (const auto& entry : cameras.entries()) {
    points.cameras.push_back(read_camera(cameras.section(entry.first), entry.first));
  }
  cameras.finish();
  root.finish();
  if (points.cameras.empty()) {
    document.fail(nullptr, "camera",
                  "there is none: [camera.NAME] and the landmarks in that camera's picture");
  }
}

}  // namespace

FacePoints parse_face_points(std::string_view text, const std::filesystem::path& file) {
  FacePoints points;
  files::read_toml(text, file, [&](files::TomlDocument& document) { read_all(document, points); });
  return points;
}

FacePoints read_face_points(const std::filesystem::path& file) {
  return parse_face_points(files::read_text(file, kMaxFacePointsFileBytes, "file of face points"), file);
}

}  // namespace facet::booth
