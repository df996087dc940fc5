#include "report/truth_folder.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "files/json_text.hpp"
#include "files/text_file.hpp"

namespace facet::report {
namespace {

using nlohmann::json;

struct UnitName {
  const char* name;
  float mm;
};
constexpr std::array<UnitName, 3> kUnits{{{"mm", 1}, {"cm", 10}, {"m", 1000}}};

// The diagonal of the box around a head, a face alone or a bust. A decade of ten in ten: one unit fits at
// most.
constexpr float kSmallest_mm = 100;
constexpr float kLargest_mm = 1000;

[[noreturn]] void refuse(const std::filesystem::path& file, const std::string& why) {
  throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", file.string(), why));
}

void check_size(const simulation::TruthMesh& mesh, float mm_per_unit, const std::filesystem::path& file) {
  const float across_mm =
      (mesh.vertices_mm.rowwise().maxCoeff() - mesh.vertices_mm.rowwise().minCoeff()).norm();
  if (across_mm >= kSmallest_mm && across_mm < kLargest_mm) {
    return;
  }
  const float across = across_mm / mm_per_unit;
  for (const UnitName& unit : kUnits) {
    if (across * unit.mm >= kSmallest_mm && across * unit.mm < kLargest_mm) {
      refuse(file,
             fmt::format("{:.4g} mm across is no head; times {:g} it would be {:.0f} mm: give --unit {}",
                         across_mm, unit.mm / mm_per_unit, across * unit.mm, unit.name));
    }
  }
  refuse(file, fmt::format("{:.4g} across is no head, neither in mm nor in cm nor in m", across));
}

/// A key's place in camera.json, for messages: frames[3].camera_from_head.
[[noreturn]] void refuse_key(const std::filesystem::path& file, const std::string& key,
                             const std::string& why) {
  refuse(file, fmt::format("{}: {}", key, why));
}

Eigen::Isometry3f read_pose(const json& value, float mm_per_unit, const std::filesystem::path& file,
                            const std::string& key) {
  Eigen::Matrix4f matrix;
  const bool has_rows = value.is_array() && value.size() == 4;
  for (std::size_t row = 0; row < 4; ++row) {
    if (!has_rows || !value[row].is_array() || value[row].size() != 4) {
      refuse_key(file, key, "not four rows of four numbers");
    }
    for (std::size_t column = 0; column < 4; ++column) {
      if (!value[row][column].is_number()) {
        refuse_key(file, key, "not four rows of four numbers");
      }
      matrix(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)) =
          value[row][column].get<float>();
    }
  }
  constexpr float kRounding = 1e-2F;
  const Eigen::Matrix3f rotation = matrix.topLeftCorner<3, 3>();
  if ((matrix.row(3) - Eigen::RowVector4f(0, 0, 0, 1)).cwiseAbs().maxCoeff() > kRounding) {
    refuse_key(file, key, "its last row is not 0 0 0 1; the matrix is written row by row");
  }
  if (!matrix.allFinite() ||
      (rotation * rotation.transpose() - Eigen::Matrix3f::Identity()).cwiseAbs().maxCoeff() > kRounding ||
      rotation.determinant() < 0) {
    refuse_key(file, key, "not a rotation and a shift (without scale or mirror)");
  }
  Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
  pose.linear() = Eigen::Quaternionf(rotation).normalized().toRotationMatrix();
  pose.translation() = mm_per_unit * matrix.topRightCorner<3, 1>();
  if (pose.translation().z() <= 0) {
    refuse_key(file, key, "puts the head behind the camera (x right, y down, z forward)");
  }
  return pose;
}

std::map<std::string, float> read_expression(const json& value, const std::filesystem::path& file,
                                             const std::string& key) {
  if (!value.is_object()) {
    refuse_key(file, key, "not an object of weights by name");
  }
  std::map<std::string, float> weights;
  for (const auto& [name, weight] : value.items()) {
    if (!weight.is_number() || !std::isfinite(weight.get<float>())) {
      refuse_key(file, key + "." + name, "not a number");
    }
    weights[name] = weight.get<float>();
  }
  return weights;
}

}  // namespace

TruthFolder::TruthFolder(std::filesystem::path folder, float mm_per_unit)
    : folder_(std::move(folder)), mm_per_unit_(mm_per_unit) {
  list_meshes();
  const std::filesystem::path notes = folder_ / "camera.json";
  if (std::filesystem::exists(notes)) {
    read_notes(notes);
  }
}

void TruthFolder::list_meshes() {
  const std::filesystem::path meshes = folder_ / "truth";
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(meshes, error)) {
    const std::string name = entry.path().filename().string();
    constexpr std::string_view kPrefix = "frame_";
    constexpr std::string_view kSuffix = ".ply";
    if (!name.starts_with(kPrefix) || !name.ends_with(kSuffix)) {
      continue;
    }
    std::uint64_t number = 0;
    const char* const first = name.data() + kPrefix.size();
    const char* const last = name.data() + name.size() - kSuffix.size();
    const auto [end, failure] = std::from_chars(first, last, number);
    if (failure != std::errc() || end != last) {
      continue;
    }
    const auto [place, is_new] = files_.emplace(number, entry.path());
    if (!is_new) {
      refuse(entry.path(), fmt::format("{} is of frame {} too", place->second.filename().string(), number));
    }
  }
  if (error) {
    refuse(meshes,
           fmt::format("cannot read this folder ({}); --truth is the folder above it", error.message()));
  }
  if (files_.empty()) {
    refuse(meshes, "no meshes frame_000000.ply and so on, numbered as the video's frames are");
  }
}

void TruthFolder::read_notes(const std::filesystem::path& file) {
  constexpr files::JsonLimits kLimits{.most_bytes = std::size_t{256} << 20U, .most_values = 20'000'000};
  const json document =
      files::parse_json(files::read_text(file, kLimits.most_bytes, "camera.json"), kLimits, file.string());
  if (!document.is_object()) {
    refuse(file, "not an object with fx, frames and so on");
  }
  if (document.contains("fx")) {
    const json& fx = document["fx"];
    if (!fx.is_number() || !(fx.get<float>() > 0)) {
      refuse_key(file, "fx", "not a focal length in px");
    }
    focal_px_ = fx.get<float>();
  }
  if (!document.contains("frames")) {
    return;
  }
  if (!document["frames"].is_array()) {
    refuse_key(file, "frames", "not a list");
  }
  std::size_t place = 0;
  for (const json& frame : document["frames"]) {
    const std::string key = fmt::format("frames[{}]", place++);
    if (!frame.is_object()) {
      refuse_key(file, key, "not an object");
    }
    if (!frame.contains("index") || !frame["index"].is_number_unsigned()) {
      refuse_key(file, key + ".index", "missing, or not the number of a frame");
    }
    TruthNotes notes;
    if (frame.contains("camera_from_head")) {
      notes.camera_from_head =
          read_pose(frame["camera_from_head"], mm_per_unit_, file, key + ".camera_from_head");
    }
    if (frame.contains("expression")) {
      notes.expression = read_expression(frame["expression"], file, key + ".expression");
    }
    const auto index = frame["index"].get<std::uint64_t>();
    if (!notes_.emplace(index, std::move(notes)).second) {
      refuse_key(file, key + ".index", fmt::format("{} stands there twice", index));
    }
  }
}

std::vector<std::uint64_t> TruthFolder::frames() const {
  std::vector<std::uint64_t> numbers;
  for (const auto& [number, file] : files_) {
    numbers.push_back(number);
  }
  return numbers;
}

simulation::TruthMesh TruthFolder::read(const std::filesystem::path& file) const {
  simulation::TruthMesh mesh = simulation::read_truth_ply(file);
  mesh.vertices_mm *= mm_per_unit_;
  check_size(mesh, mm_per_unit_, file);
  wind_outwards(mesh);
  return mesh;
}

simulation::TruthMesh TruthFolder::mesh(std::uint64_t frame) const {
  const std::filesystem::path& file = files_.at(frame);
  simulation::TruthMesh mesh = read(file);
  if (mesh.vertices_mm.row(2).mean() <= 0) {
    refuse(file, "lies behind the camera: truth is in the camera frame, x right, y down, z forward");
  }
  return mesh;
}

std::optional<simulation::TruthMesh> TruthFolder::neutral() const {
  const std::filesystem::path file = folder_ / "truth" / "neutral.ply";
  if (!std::filesystem::exists(file)) {
    return std::nullopt;
  }
  return read(file);
}

const TruthNotes* TruthFolder::notes(std::uint64_t frame) const {
  const auto found = notes_.find(frame);
  return found == notes_.end() ? nullptr : &found->second;
}

void wind_outwards(simulation::TruthMesh& mesh) {
  using Eigen::Vector3d;
  double along = 0;
  double total_mm2 = 0;
  Vector3d centre_mm = Vector3d::Zero();
  std::vector<std::pair<Vector3d, Vector3d>> pieces;  // twice the area with its direction, middle
  pieces.reserve(static_cast<std::size_t>(mesh.triangles.cols()));
  for (Eigen::Index t = 0; t < mesh.triangles.cols(); ++t) {
    const auto corner = [&](Eigen::Index k) {
      return Vector3d(mesh.vertices_mm.col(mesh.triangles(k, t)).cast<double>());
    };
    const Vector3d area_mm2 = (corner(1) - corner(0)).cross(corner(2) - corner(0));
    const Eigen::Vector3f normal = mesh.normals.col(mesh.triangles(0, t)) +
                                   mesh.normals.col(mesh.triangles(1, t)) +
                                   mesh.normals.col(mesh.triangles(2, t));
    pieces.emplace_back(area_mm2, (corner(0) + corner(1) + corner(2)) / 3);
    along += area_mm2.dot(normal.cast<double>());
    total_mm2 += area_mm2.norm();
    centre_mm += area_mm2.norm() * pieces.back().second;
  }
  centre_mm /= total_mm2;
  double outward_mm3 = 0;
  double reach_mm3 = 0;
  for (const auto& [area_mm2, middle_mm] : pieces) {
    outward_mm3 += area_mm2.dot(middle_mm - centre_mm);
    reach_mm3 += area_mm2.norm() * (middle_mm - centre_mm).norm();
  }
  if (along < 0) {
    mesh.triangles.row(1).swap(mesh.triangles.row(2));
    outward_mm3 = -outward_mm3;
  }
  constexpr double kClearly = 0.05;
  if (outward_mm3 < -kClearly * reach_mm3) {
    mesh.triangles.row(1).swap(mesh.triangles.row(2));
    mesh.normals = -mesh.normals;
  }
}

}  // namespace facet::report
