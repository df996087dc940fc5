// Plate and ball of the virtual booth, measured by spacetime stereo and by structured light, in the terms in
// which scanners are accepted (VDI/VDE 2634 part 2). Prints markdown.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "maths/statistics.hpp"
#include "render/renderer.hpp"
#include "scan/structured_light.hpp"
#include "simulation/virtual_booth.hpp"
#include "stereo/stereo_matcher.hpp"
#include "stereo_footage.hpp"

namespace {

using Eigen::Vector3d;
using facet::bench::SceneOptions;

struct Options {
  std::vector<std::uint32_t> seeds{1, 2, 3};
  std::size_t pair = 0;
  std::string sequence = "phase:8x64,gray:6,gray-inverse:6";
  std::string device = "auto";
  std::filesystem::path pictures;
  facet::scan::DecodeOptions decode;
};

/// A point of a map, rig frame, and the pixel it comes from.
struct Point {
  Vector3d at_mm;
  std::size_t pixel;
};
using Points = std::vector<Point>;

Points points_of(const facet::capture::DepthMap& map) {
  Points points;
  const Eigen::Isometry3d rig_from_map = map.lens.camera_from_rig.inverse();
  for (int y = 0; y < map.height_px; ++y) {
    for (int x = 0; x < map.width_px; ++x) {
      const std::size_t pixel =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(map.width_px) + static_cast<std::size_t>(x);
      const auto depth = static_cast<double>(map.depth_mm[pixel]);
      if (depth > 0) {
        const Vector3d in_map(depth * (x - map.lens.cx_px) / map.lens.fx_px,
                              depth * (y - map.lens.cy_px) / map.lens.fy_px, depth);
        points.push_back({rig_from_map * in_map, pixel});
      }
    }
  }
  return points;
}

/// max - min, without the given part of the values that lie farthest from 0.
double range_without(std::vector<double> residuals, double part) {
  std::sort(residuals.begin(), residuals.end(), [](double a, double b) { return std::abs(a) < std::abs(b); });
  const auto kept =
      static_cast<std::ptrdiff_t>(std::ceil((1 - part) * static_cast<double>(residuals.size())));
  const auto [least, most] = std::minmax_element(residuals.begin(), residuals.begin() + kept);
  return *most - *least;
}

double root_mean_square(const std::vector<double>& residuals) {
  double square = 0;
  for (const double residual : residuals) {
    square += residual * residual;
  }
  return std::sqrt(square / static_cast<double>(residuals.size()));
}

constexpr double kRejected = 0.003;  // VDI/VDE 2634: three of a thousand points may be left out

/// Signed distances to the best plane (least squares).
std::vector<double> plane_residuals(const Points& points) {
  Vector3d mean = Vector3d::Zero();
  for (const Point& point : points) {
    mean += point.at_mm / static_cast<double>(points.size());
  }
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const Point& point : points) {
    spread += (point.at_mm - mean) * (point.at_mm - mean).transpose();
  }
  const Vector3d normal = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvectors().col(0);
  std::vector<double> residuals;
  for (const Point& point : points) {
    residuals.push_back(normal.dot(point.at_mm - mean));
  }
  return residuals;
}

struct Sphere {
  Vector3d centre{0, 0, 0};
  double radius = 0;
};

/// The best sphere (least squares of the distances), by Gauss-Newton.
Sphere fit_sphere(const Points& points, const Sphere& start) {
  Sphere sphere = start;
  for (int step = 0; step < 20; ++step) {
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    for (const Point& point : points) {
      const Vector3d out = point.at_mm - sphere.centre;
      const Vector3d towards = -out.normalized();
      const Eigen::Vector4d row(towards.x(), towards.y(), towards.z(), -1);
      normal += row * row.transpose();
      right -= row * (out.norm() - sphere.radius);
    }
    const Eigen::Vector4d move = normal.ldlt().solve(right);
    sphere.centre += move.head<3>();
    sphere.radius += move[3];
    if (move.norm() < 1e-9) {
      break;
    }
  }
  return sphere;
}

/// Noise of points: their spread about the mean of the eight around them, within one surface. sqrt(8 / 9) of
/// white noise's deviation is left, which is taken into account; what is alike in neighbours is not seen.
double point_noise(const facet::capture::DepthMap& map) {
  const auto width = static_cast<std::size_t>(map.width_px);
  std::vector<double> values;
  for (int y = 1; y + 1 < map.height_px; ++y) {
    for (int x = 1; x + 1 < map.width_px; ++x) {
      const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
      double sum = 0;
      bool whole = map.depth_mm[at] > 0;
      for (int k = 0; k < 9 && whole; ++k) {
        const float there = map.depth_mm[at + static_cast<std::size_t>(k / 3) * width - width +
                                         static_cast<std::size_t>(k % 3) - 1];
        whole = there > 0 && std::abs(there - map.depth_mm[at]) < 5;
        sum += static_cast<double>(there) / 9;
      }
      if (whole) {
        values.push_back(std::abs(static_cast<double>(map.depth_mm[at]) - sum));
      }
    }
  }
  // The median of absolute values, so that a bent rim does not count.
  return 1.4826 * facet::maths::median_of(values) / std::sqrt(8.0 / 9);
}

struct Method {
  std::string name;
  std::vector<double> flatness, flatness_all, rms, noise, diameter, form, form_all, spacing;
};

class Bench {
 public:
  explicit Bench(const Options& options) : options_(options), context_(context_options(options)) {
    methods_[0].name = "spacetime stereo, pattern slots";
    methods_[1].name = "structured light, two cameras";
    methods_[2].name = "structured light, camera and projector";
  }

  void run() {
    for (const std::uint32_t seed : options_.seeds) {
      measure_plate(seed);
      measure_balls(seed);
    }
    fmt::print(
        "| method | F, mm | F without 0.3 % | rms, mm | noise, mm | PS, mm | PF, mm | PF without 0.3 % | SD, "
        "mm "
        "|\n|---|---|---|---|---|---|---|---|---|\n");
    for (const Method& method : methods_) {
      fmt::print("| {} | {} | {} | {} | {} | {} | {} | {} | {} |\n", method.name, row(method.flatness_all),
                 row(method.flatness), row(method.rms), row(method.noise), row(method.diameter),
                 row(method.form_all), row(method.form), row(method.spacing));
    }
  }

 private:
  static facet::gpu::ContextOptions context_options(const Options& options) {
    facet::gpu::ContextOptions out;
    out.device = options.device;
    return out;
  }

  static std::string row(const std::vector<double>& values) {
    std::string text;
    for (const double value : values) {
      text += fmt::format("{}{:.3f}", text.empty() ? "" : ", ", value);
    }
    return text;
  }

  /// The maps of a scene by every method.
  std::array<facet::capture::DepthMap, 3> maps_of(const std::string& scene, std::uint32_t seed,
                                                  const Vector3d& shift_mm,
                                                  facet::simulation::BoothTarget& target) {
    SceneOptions scene_options;
    scene_options.seed = seed;
    scene_options.slots = 5;
    scene_options.sequence = facet::capture::parse_sequence(options_.sequence);
    facet::simulation::VirtualBoothConfig config = facet::bench::booth_config(scene, scene_options);
    config.target_shift_mm = shift_mm;
    const facet::simulation::VirtualBooth booth(nullptr, config);
    target = *booth.target();
    const facet::bench::StereoFootage footage =
        facet::bench::booth_footage(booth, scene, options_.pair, scene_options);
    facet::stereo::StereoOptions stereo;
    stereo.depths = footage.depths;
    stereo.most_slots = scene_options.slots;
    facet::stereo::StereoMatcher matcher(context_, footage.rig, footage.pair, stereo);
    std::vector<facet::capture::DepthMap> maps;
    if (matcher.match(footage.slots, maps) != facet::stereo::StereoOutcome::Done) {
      throw facet::Error(facet::ErrorKind::Internal, matcher.failure());
    }
    const facet::bench::CodedFootage coded =
        facet::bench::coded_footage(booth, scene, options_.pair, scene_options, options_.decode);
    facet::scan::StructuredLightOptions match;
    match.depths = footage.depths;
    // Slot 61 of the program shows stripes B, with two pattern slots and a blank one within its window.
    return {maps[1],
            facet::scan::match_phases(booth.rig(), coded.pair.pair, coded.left, coded.right, match).map,
            facet::scan::triangulate_phases(booth.rig(), coded.left_camera, coded.projector_index, coded.left,
                                            match)
                .map};
  }

  /// Residuals in colour: blue in front of the ideal surface, red behind it, white on it, full at 0.25 mm.
  void draw(const std::string& name, const facet::capture::DepthMap& map, const Points& points,
            const std::vector<double>& residuals) const {
    if (options_.pictures.empty()) {
      return;
    }
    constexpr double kFull_mm = 0.25;
    facet::render::Picture picture = facet::render::plain_picture(map.width_px, map.height_px, {60, 60, 60});
    for (std::size_t k = 0; k < points.size(); ++k) {
      const double part = std::clamp(residuals[k] / kFull_mm, -1.0, 1.0);
      const auto faded = static_cast<std::uint8_t>(255 * (1 - std::abs(part)));
      std::uint8_t* rgb = picture.rgb.data() + 3 * points[k].pixel;
      rgb[0] = part < 0 ? faded : std::uint8_t{255};
      rgb[1] = faded;
      rgb[2] = part > 0 ? faded : std::uint8_t{255};
    }
    std::filesystem::create_directories(options_.pictures);
    facet::render::write_png(picture, options_.pictures / (name + ".png"));
  }

  void measure_plate(std::uint32_t seed) {
    facet::simulation::BoothTarget target;
    const auto maps = maps_of("booth-plane", seed, Vector3d::Zero(), target);
    for (std::size_t k = 0; k < methods_.size(); ++k) {
      // The plate's rim is no part of the plane: what lies 5 mm or more inside of it is.
      constexpr double kHalf_mm = 115;
      Points inside;
      for (const Point& point : points_of(maps[k])) {
        const Vector3d off = point.at_mm - target.centre_mm;
        const Vector3d flat = off - off.dot(target.normal) * target.normal;
        // Along the plate's sides, which are the rig's x and y turned with it.
        const Eigen::Quaterniond turn = Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), target.normal);
        const Vector3d side = turn.inverse() * flat;
        if (std::abs(side.x()) < kHalf_mm && std::abs(side.y()) < kHalf_mm) {
          inside.push_back(point);
        }
      }
      const std::vector<double> residuals = plane_residuals(inside);
      draw(fmt::format("plate-{}-{}", seed, k), maps[k], inside, residuals);
      methods_[k].rms.push_back(root_mean_square(residuals));
      methods_[k].flatness_all.push_back(range_without(residuals, 0));
      methods_[k].flatness.push_back(range_without(residuals, kRejected));
      methods_[k].noise.push_back(point_noise(maps[k]));
    }
  }

  void measure_balls(std::uint32_t seed) {
    std::array<std::array<Vector3d, 3>, 2> centres;
    std::array<Vector3d, 2> true_centres;
    for (const std::size_t place : {std::size_t{0}, std::size_t{1}}) {
      facet::simulation::BoothTarget target;
      const Vector3d shift = place == 0 ? Vector3d(-45, -25, -15) : Vector3d(45, 25, 15);
      const auto maps = maps_of("booth-sphere", seed, shift, target);
      true_centres.at(place) = target.centre_mm;
      for (std::size_t k = 0; k < methods_.size(); ++k) {
        // What faces the camera to within 60 degrees: the cap that a tactile check of the ball takes.
        const Vector3d camera = maps[k].lens.centre_mm();
        Points cap;
        for (const Point& point : points_of(maps[k])) {
          const Vector3d out = point.at_mm - target.centre_mm;
          if (out.normalized().dot((camera - target.centre_mm).normalized()) > 0.5) {
            cap.push_back(point);
          }
        }
        const Sphere sphere = fit_sphere(cap, {target.centre_mm, target.radius_mm});
        centres.at(place).at(k) = sphere.centre;
        std::vector<double> residuals;
        for (const Point& point : cap) {
          residuals.push_back((point.at_mm - sphere.centre).norm() - sphere.radius);
        }
        draw(fmt::format("ball-{}-{}-{}", seed, place, k), maps[k], cap, residuals);
        if (place == 0) {
          methods_[k].diameter.push_back(2 * (sphere.radius - target.radius_mm));
          methods_[k].form_all.push_back(range_without(residuals, 0));
          methods_[k].form.push_back(range_without(residuals, kRejected));
        }
      }
    }
    for (std::size_t k = 0; k < methods_.size(); ++k) {
      methods_[k].spacing.push_back((centres[1].at(k) - centres[0].at(k)).norm() -
                                    (true_centres[1] - true_centres[0]).norm());
    }
  }

  Options options_;
  facet::gpu::Context context_;
  std::array<Method, 3> methods_;
};

}  // namespace

int main(int argc, char** argv) {
  Options options;
  options.decode.response = facet::scan::Response::Srgb;  // the booth's cameras
  CLI::App app("Plate and ball of the virtual booth, measured, in the terms of VDI/VDE 2634 part 2");
  app.add_option("--seeds", options.seeds)->delimiter(',');
  app.add_option("--pair", options.pair, "of the booth: 0 or 1");
  app.add_option("--sequence", options.sequence, "of structured light");
  app.add_option("--smooth", options.decode.smooth_px, "of structured light's phases, px");
  app.add_option("--device", options.device);
  app.add_option("--pictures", options.pictures, "folder for what is left after the fits");
  CLI11_PARSE(app, argc, argv);
  try {
    Bench(options).run();
  } catch (const facet::Error& error) {
    fmt::print(stderr, "{}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
