#include "calibration/exchange.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <iterator>
#include <optional>
#include <vector>

#include "calibration/calibrator.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "facet/frame_set.hpp"
#include "files/text_file.hpp"

namespace facet::calibration {
namespace {

constexpr double kMillimetresPerMetre = 1000;
constexpr double kMostSkew = 1e-4;  // of rotations that others wrote with few digits; made exact here

/// A YAML file whose errors name file, line and key; the tree's only YAML parser. The library itself refuses
/// what nests deeper than 500 levels, and takes 240 bytes a byte at most ("[,").
class Yaml {
 public:
  Yaml(std::string_view text, std::filesystem::path file) : file_(std::move(file)) {
    if (text.size() > kMaxYamlBytes) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("{}: no calibration: it has more than {} bytes",
                                                          file_.string(), kMaxYamlBytes));
    }
    std::string own(text);
    // OpenCV begins its files with "%YAML:1.0", which is no YAML.
    if (own.rfind("%YAML:", 0) == 0) {
      std::replace(own.begin(),
                   own.begin() + static_cast<std::ptrdiff_t>(std::min(own.find('\n'), own.size())), '%', '#');
    }
    try {
      root_ = YAML::Load(own);
    } catch (const YAML::Exception& error) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}:{}: not valid YAML: {}", file_.string(), error.mark.line + 1, error.msg));
    }
    if (!root_.IsMap()) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{}: no calibration: its YAML has no keys at the top", file_.string()));
    }
  }

  const YAML::Node& root() const { return root_; }

  [[noreturn]] void fail(const YAML::Node& at, const std::string& key, const std::string& what) const {
    const int line = at.IsDefined() ? at.Mark().line + 1 : 0;
    throw Error(ErrorKind::UnreadableInput,
                line > 0 ? fmt::format("{}:{}: {}: {}", file_.string(), line, key, what)
                         : fmt::format("{}: {}: {}", file_.string(), key, what));
  }

  YAML::Node need(const YAML::Node& parent, const std::string& key, const std::string& name) const {
    const YAML::Node found = parent.IsMap() ? parent[key] : YAML::Node(YAML::NodeType::Undefined);
    if (!found.IsDefined()) {
      fail(parent, name, "is missing");
    }
    return found;
  }

  double number(const YAML::Node& node, const std::string& name) const {
    double value = 0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value) || !std::isfinite(value)) {
      fail(node, name, "must be a number");
    }
    return value;
  }

  std::vector<double> numbers(const YAML::Node& node, const std::string& name, std::size_t most) const {
    if (!node.IsSequence() || node.size() > most) {
      fail(node, name, fmt::format("must be a list of at most {} numbers", most));
    }
    std::vector<double> values;
    for (const YAML::Node& one : node) {
      values.push_back(number(one, name));
    }
    return values;
  }

  int whole_number(const YAML::Node& node, const std::string& name) const {
    const double value = number(node, name);
    if (!(value >= 16 && value <= 65536) || value != std::floor(value)) {
      fail(node, name, "must be a picture's size, 16 to 65536 px");
    }
    return static_cast<int>(value);
  }

  Eigen::Matrix3d rotation(const YAML::Node& node, const std::string& name,
                           const Eigen::Matrix3d& given) const {
    const double skew = (given * given.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
    if (!(skew <= kMostSkew) || given.determinant() < 0) {
      fail(node, name, "is no rotation: its rows are not unit vectors at right angles");
    }
    return Eigen::Quaterniond(given).normalized().toRotationMatrix();
  }

 private:
  std::filesystem::path file_;
  YAML::Node root_;
};

/// The numbers of an !!opencv-matrix, row by row; rows and cols are checked against them.
struct OpenCvMatrix {
  int rows = 0;
  int columns = 0;
  std::vector<double> values;
};

OpenCvMatrix read_matrix(const Yaml& yaml, const std::string& key) {
  constexpr std::size_t kMostValues = 64;
  const YAML::Node node = yaml.need(yaml.root(), key, key);
  OpenCvMatrix matrix;
  const double rows = yaml.number(yaml.need(node, "rows", key + ".rows"), key + ".rows");
  const double columns = yaml.number(yaml.need(node, "cols", key + ".cols"), key + ".cols");
  matrix.values = yaml.numbers(yaml.need(node, "data", key + ".data"), key + ".data", kMostValues);
  if (!(rows >= 1 && columns >= 1) || rows * columns != static_cast<double>(matrix.values.size())) {
    yaml.fail(node, key, fmt::format("has {} numbers, not {} x {}", matrix.values.size(), rows, columns));
  }
  matrix.rows = static_cast<int>(rows);
  matrix.columns = static_cast<int>(columns);
  return matrix;
}

Eigen::Matrix3d read_matrix3(const Yaml& yaml, const std::string& key) {
  const OpenCvMatrix matrix = read_matrix(yaml, key);
  if (matrix.rows != 3 || matrix.columns != 3) {
    yaml.fail(yaml.root()[key], key, "must be a 3 x 3 matrix");
  }
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(matrix.values.data());
}

/// A plausible lens, so that what is imported can be written as a rig file.
/// pinhole: fx, fy, cx, cy, pixels.
void set_pinhole(const Yaml& yaml, const YAML::Node& node, const std::string& name,
                 const std::array<double, 4>& pinhole, capture::Lens& lens) {
  const auto [fx, fy, cx, cy] = pinhole;
  lens.fx_px = fx;
  lens.fy_px = fy;
  lens.cx_px = cx;
  lens.cy_px = cy;
  constexpr double kMost = 1e6;
  const auto inside = [](double at, int size) { return at >= -size && at <= 2.0 * size; };
  if (!(fx >= 1 && fx <= kMost && fy >= 1 && fy <= kMost)) {
    yaml.fail(node, name, fmt::format("a focal length of {} and {} px: 1 to {} are possible", fx, fy, kMost));
  }
  if (!inside(cx, lens.width_px) || !inside(cy, lens.height_px)) {
    yaml.fail(node, name,
              fmt::format("the principal point ({}, {}) lies far outside a picture of {}x{} px", cx, cy,
                          lens.width_px, lens.height_px));
  }
}

void set_distortion(const Yaml& yaml, const YAML::Node& node, const std::string& name,
                    const std::vector<double>& values, capture::Lens& lens) {
  constexpr double kMost = 1e3;
  const auto large = [](double value) { return std::abs(value) > kMost; };
  if (std::any_of(values.begin(), values.end(), large)) {
    yaml.fail(node, name, fmt::format("coefficients beyond {} are no lens", kMost));
  }
  const auto value = [&](std::size_t i) { return i < values.size() ? values[i] : 0.0; };
  lens.distortion = {value(0), value(1), value(2), value(3), value(4)};
}

void check_distance(const Yaml& yaml, const YAML::Node& node, const std::string& name,
                    const Eigen::Vector3d& at_mm) {
  constexpr double kMost_mm = 1e6;
  if (!(at_mm.cwiseAbs().maxCoeff() <= kMost_mm)) {
    yaml.fail(node, name, "a camera more than a kilometre away: are the units right?");
  }
}

capture::RigCamera read_opencv_camera(const Yaml& yaml, char number, const std::string& name, int width_px,
                                      int height_px) {
  const std::string matrix_key = std::string("M") + number;
  const std::string distortion_key = std::string("D") + number;
  capture::RigCamera camera;
  camera.name = name;
  capture::Lens& lens = camera.lens;
  lens.width_px = width_px;
  lens.height_px = height_px;
  const Eigen::Matrix3d matrix = read_matrix3(yaml, matrix_key);
  const YAML::Node matrix_node = yaml.root()[matrix_key];
  if (matrix(1, 0) != 0 || matrix(2, 0) != 0 || matrix(2, 1) != 0 || matrix(2, 2) != 1) {
    yaml.fail(matrix_node, matrix_key, "is no camera matrix: [fx 0 cx; 0 fy cy; 0 0 1]");
  }
  if (matrix(0, 1) != 0) {
    yaml.fail(matrix_node, matrix_key, "has a skew; lenses here have none");
  }
  set_pinhole(yaml, matrix_node, matrix_key, {matrix(0, 0), matrix(1, 1), matrix(0, 2), matrix(1, 2)}, lens);
  const std::vector<double> values = read_matrix(yaml, distortion_key).values;
  if (values.size() > 5 &&
      std::any_of(values.begin() + 5, values.end(), [](double value) { return value != 0; })) {
    yaml.fail(
        yaml.root()[distortion_key], distortion_key,
        fmt::format("{} coefficients: the rational, thin-prism and tilted models of OpenCV are not known "
                    "here; calibrate with k1, k2, p1, p2, k3",
                    values.size()));
  }
  set_distortion(yaml, yaml.root()[distortion_key], distortion_key, values, lens);
  return camera;
}

void format_matrix(fmt::memory_buffer& text, const std::string& key, const Eigen::MatrixXd& matrix) {
  std::vector<std::string> values;
  for (Eigen::Index y = 0; y < matrix.rows(); ++y) {
    for (Eigen::Index x = 0; x < matrix.cols(); ++x) {
      values.push_back(fmt::format("{:.17e}", matrix(y, x)));
    }
  }
  fmt::format_to(std::back_inserter(text),
                 "{}: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ {} ]\n", key,
                 matrix.rows(), matrix.cols(), fmt::join(values, ",\n       "));
}

Eigen::Matrix3d camera_matrix(const capture::Lens& lens) {
  Eigen::Matrix3d matrix;
  matrix << lens.fx_px, 0, lens.cx_px, 0, lens.fy_px, lens.cy_px, 0, 0, 1;
  return matrix;
}

Eigen::Matrix<double, 1, 5> distortion_row(const capture::Lens& lens) {
  const capture::LensDistortion& bent = lens.distortion;
  return {bent.k1, bent.k2, bent.p1, bent.p2, bent.k3};
}

std::string text_of(const Yaml& yaml, const YAML::Node& node, const std::string& name) {
  if (!node.IsScalar()) {
    yaml.fail(node, name, "must be a word");
  }
  return node.Scalar();
}

/// T_cn_cnm1: where the camera stands from the one before it, 4 x 4, metres.
Eigen::Isometry3d read_kalibr_pose(const Yaml& yaml, const YAML::Node& node, const std::string& name) {
  Eigen::Matrix4d matrix;
  if (!node.IsSequence() || node.size() != 4) {
    yaml.fail(node, name, "must be four rows of four numbers");
  }
  for (std::size_t y = 0; y < 4; ++y) {
    const std::vector<double> row = yaml.numbers(node[y], name, 4);
    if (row.size() != 4) {
      yaml.fail(node[y], name, "must be four rows of four numbers");
    }
    matrix.row(static_cast<Eigen::Index>(y)) = Eigen::Map<const Eigen::RowVector4d>(row.data());
  }
  if (matrix.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) {
    yaml.fail(node, name, "must end with the row 0, 0, 0, 1");
  }
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = yaml.rotation(node, name, matrix.topLeftCorner<3, 3>());
  pose.translation() = kMillimetresPerMetre * matrix.topRightCorner<3, 1>();
  check_distance(yaml, node, name, pose.translation());
  return pose;
}

capture::RigCamera read_kalibr_camera(const Yaml& yaml, const YAML::Node& node, const std::string& name) {
  const auto need = [&](const char* key) { return yaml.need(node, key, name + "." + key); };
  capture::RigCamera camera;
  camera.name = name;
  const std::string model = text_of(yaml, need("camera_model"), name + ".camera_model");
  if (model != "pinhole") {
    yaml.fail(need("camera_model"), name + ".camera_model",
              fmt::format("'{}' is not known here; calibrate with pinhole-radtan", model));
  }
  const std::string distortion = text_of(yaml, need("distortion_model"), name + ".distortion_model");
  if (distortion != "radtan" && distortion != "none") {
    yaml.fail(need("distortion_model"), name + ".distortion_model",
              fmt::format("'{}' is not known here; calibrate with pinhole-radtan", distortion));
  }
  const YAML::Node resolution = need("resolution");
  if (!resolution.IsSequence() || resolution.size() != 2) {
    yaml.fail(resolution, name + ".resolution", "must be [width, height]");
  }
  camera.lens.width_px = yaml.whole_number(resolution[0], name + ".resolution");
  camera.lens.height_px = yaml.whole_number(resolution[1], name + ".resolution");
  const std::vector<double> intrinsics = yaml.numbers(need("intrinsics"), name + ".intrinsics", 4);
  if (intrinsics.size() != 4) {
    yaml.fail(need("intrinsics"), name + ".intrinsics", "must be [fu, fv, pu, pv]");
  }
  set_pinhole(yaml, need("intrinsics"), name + ".intrinsics",
              {intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]}, camera.lens);
  const std::vector<double> coefficients =
      yaml.numbers(need("distortion_coeffs"), name + ".distortion_coeffs", 4);
  if (distortion == "radtan" && coefficients.size() != 4) {
    yaml.fail(need("distortion_coeffs"), name + ".distortion_coeffs", "must be [k1, k2, r1, r2]");
  }
  set_distortion(yaml, need("distortion_coeffs"), name + ".distortion_coeffs",
                 distortion == "none" ? std::vector<double>{} : coefficients, camera.lens);
  return camera;
}

}  // namespace

capture::Rig parse_opencv(std::string_view intrinsics, const std::filesystem::path& intrinsics_file,
                          std::string_view extrinsics, const std::filesystem::path& extrinsics_file,
                          const OpenCvImport& import) {
  const Yaml lenses(intrinsics, intrinsics_file);
  const Yaml poses(extrinsics, extrinsics_file);
  int width_px = import.width_px;
  int height_px = import.height_px;
  if (width_px == 0 || height_px == 0) {
    if (!lenses.root()["image_width"].IsDefined()) {
      lenses.fail(lenses.root(), "image_width",
                  "is missing: OpenCV's stereo sample does not write the pictures' size; give it (--size)");
    }
    width_px = lenses.whole_number(lenses.root()["image_width"], "image_width");
    height_px =
        lenses.whole_number(lenses.need(lenses.root(), "image_height", "image_height"), "image_height");
  }
  capture::Rig rig;
  rig.cameras.push_back(read_opencv_camera(lenses, '1', import.left, width_px, height_px));
  rig.cameras.push_back(read_opencv_camera(lenses, '2', import.right, width_px, height_px));
  capture::Lens& right = rig.cameras[1].lens;
  const Eigen::Matrix3d turn = read_matrix3(poses, "R");
  right.camera_from_rig.linear() = poses.rotation(poses.root()["R"], "R", turn);
  const OpenCvMatrix shift = read_matrix(poses, "T");
  if (shift.values.size() != 3) {
    poses.fail(poses.root()["T"], "T", "must have three numbers");
  }
  right.camera_from_rig.translation() << shift.values[0], shift.values[1], shift.values[2];
  right.camera_from_rig.translation() *= import.unit_mm;
  check_distance(poses, poses.root()["T"], "T", right.camera_from_rig.translation());
  rig.pairs = {{0, 1}};
  return rig;
}

OpenCvTexts format_opencv(const capture::Rig& rig, const capture::StereoPair& pair) {
  const capture::Lens& left = rig.cameras.at(pair.left).lens;
  const capture::Lens& right = rig.cameras.at(pair.right).lens;
  if (left.width_px != right.width_px || left.height_px != right.height_px) {
    throw Error(ErrorKind::Usage,
                "the two cameras of the pair have pictures of different sizes, which OpenCV's files "
                "can't say");
  }
  constexpr const char* kHead = "%YAML:1.0\n---\n";
  fmt::memory_buffer lenses;
  fmt::format_to(std::back_inserter(lenses), "{}image_width: {}\nimage_height: {}\n", kHead, left.width_px,
                 left.height_px);
  format_matrix(lenses, "M1", camera_matrix(left));
  format_matrix(lenses, "D1", distortion_row(left));
  format_matrix(lenses, "M2", camera_matrix(right));
  format_matrix(lenses, "D2", distortion_row(right));
  const Eigen::Isometry3d right_from_left = right.camera_from_rig * left.camera_from_rig.inverse();
  fmt::memory_buffer poses;
  fmt::format_to(std::back_inserter(poses), "{}", kHead);
  format_matrix(poses, "R", right_from_left.linear());
  format_matrix(poses, "T", right_from_left.translation());
  return {fmt::to_string(lenses), fmt::to_string(poses)};
}

capture::Rig parse_kalibr(std::string_view text, const std::filesystem::path& file) {
  const Yaml yaml(text, file);
  capture::Rig rig;
  for (std::size_t i = 0;; ++i) {
    const std::string name = fmt::format("cam{}", i);
    const YAML::Node node = yaml.root()[name];
    if (!node.IsDefined()) {
      break;
    }
    if (i == kMaxCameras) {
      yaml.fail(node, name, fmt::format("there are more than {} cameras", kMaxCameras));
    }
    rig.cameras.push_back(read_kalibr_camera(yaml, node, name));
    if (i > 0) {
      const Eigen::Isometry3d from_last =
          read_kalibr_pose(yaml, yaml.need(node, "T_cn_cnm1", name + ".T_cn_cnm1"), name + ".T_cn_cnm1");
      Eigen::Isometry3d& pose = rig.cameras[i].lens.camera_from_rig;
      pose = from_last * rig.cameras[i - 1].lens.camera_from_rig;
      pose.linear() = Eigen::Quaterniond(pose.linear()).normalized().toRotationMatrix();
      check_distance(yaml, node, name, pose.translation());
    }
  }
  if (rig.cameras.empty()) {
    yaml.fail(yaml.root(), "cam0", "is missing: a Kalibr camchain names its cameras cam0, cam1 ...");
  }
  rig.pairs = pairs_of_neighbours(rig.cameras);
  return rig;
}

std::string format_kalibr(const capture::Rig& rig) {
  fmt::memory_buffer text;
  const auto out = std::back_inserter(text);
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    const capture::RigCamera& camera = rig.cameras[i];
    const capture::Lens& lens = camera.lens;
    const capture::LensDistortion& bent = lens.distortion;
    if (bent.k3 != 0) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("camera '{}' has a k3 of {}; Kalibr's radtan model has none: calibrate without --k3",
                      camera.name, bent.k3));
    }
    fmt::format_to(out, "cam{}:\n", i);
    if (i > 0) {
      const Eigen::Isometry3d from_last =
          lens.camera_from_rig * rig.cameras[i - 1].lens.camera_from_rig.inverse();
      Eigen::Matrix4d pose = from_last.matrix();
      pose.topRightCorner<3, 1>() /= kMillimetresPerMetre;
      fmt::format_to(out, "  T_cn_cnm1:\n");
      for (Eigen::Index y = 0; y < 4; ++y) {
        fmt::format_to(out, "  - [{}, {}, {}, {}]\n", pose(y, 0), pose(y, 1), pose(y, 2), pose(y, 3));
      }
    }
    fmt::format_to(
        out,
        "  camera_model: pinhole\n  distortion_coeffs: [{}, {}, {}, {}]\n  distortion_model: radtan\n  "
        "intrinsics: [{}, {}, {}, {}]\n  resolution: [{}, {}]\n  rostopic: /cam{}/image_raw\n",
        bent.k1, bent.k2, bent.p1, bent.p2, lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, lens.width_px,
        lens.height_px, i);
  }
  return fmt::to_string(text);
}

capture::Rig read_any_rig(const std::filesystem::path& file, const std::filesystem::path& extrinsics,
                          const OpenCvImport& import) {
  if (file.extension() == ".toml") {
    return capture::read_rig(file);
  }
  const std::string text = files::read_text(file, kMaxYamlBytes, "calibration");
  const Yaml yaml(text, file);
  if (yaml.root()["cam0"].IsDefined()) {
    return parse_kalibr(text, file);
  }
  if (yaml.root()["M1"].IsDefined()) {
    if (extrinsics.empty()) {
      if (!yaml.root()["R"].IsDefined()) {
        yaml.fail(yaml.root(), "R",
                  "is missing: OpenCV writes R and T into a file of their own, extrinsics.yml; name it "
                  "too (--extrinsics)");
      }
      return parse_opencv(text, file, text, file, import);
    }
    return parse_opencv(text, file, files::read_text(extrinsics, kMaxYamlBytes, "calibration"), extrinsics,
                        import);
  }
  throw Error(
      ErrorKind::UnreadableInput,
      fmt::format("{}: neither a rig file (.toml) nor OpenCV's intrinsics (M1, D1, M2, D2) nor a Kalibr "
                  "camchain (cam0 ...)",
                  file.string()));
}

}  // namespace facet::calibration
