// Do points of the tracked surface stay where another, independent detector sees the same features? dlib's 68
// landmarks of one good frame are put on the surface, and followed. What the true surfaces of synthetic
// sequences score in the same way is what the detector itself allows; "held" is what a surface that never
// moves scores.

#include <dlib/image_processing.h>
#include <dlib/image_processing/frontal_face_detector.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "simulation/sequence.hpp"
#include "simulation/truth_mesh.hpp"
#include "track/tracker.hpp"

namespace {

using facet::CameraIntrinsics;
using facet::Frame;
using facet::mesh::Triangles;
using facet::mesh::Vertices;

struct Options {
  std::filesystem::path model = facet::default_model_file();
  std::filesystem::path assets = facet::default_landmark_nets();
  std::filesystem::path predictor = "/usr/share/dlib/shape_predictor_68_face_landmarks.dat";
  std::vector<std::filesystem::path> inputs;
  int every = 15;
  std::size_t frames = 0;  // 0: all
};

constexpr int kLandmarks = 68;
using Points = Eigen::Matrix<float, 2, kLandmarks>;

/// Parts of the face by dlib's numbers; the outline of the jaw (0 to 16) slides along the skin and is left
/// out.
struct Part {
  const char* name;
  int first, end;
};
constexpr std::array<Part, 4> kParts = {
    {{"brows", 17, 27}, {"nose", 27, 36}, {"eyes", 36, 48}, {"mouth", 48, 68}}};
constexpr int kFirst = 17;
constexpr int kRightEyeOuter = 36;
constexpr int kLeftEyeOuter = 45;

class Detector {
 public:
  explicit Detector(const std::filesystem::path& predictor) : detector_(dlib::get_frontal_face_detector()) {
    dlib::deserialize(predictor.string()) >> predictor_;
  }

  struct Face {
    double score = 0;
    Points points_px;
  };

  /// The face with the best score, where there is one.
  std::optional<Face> find(const Frame& frame) {
    constexpr int kSearchedSide_px = 640;  // faces of 80 px and more are found
    const facet::render::Picture picture = facet::render::to_picture(frame);
    const int side = std::max(picture.width_px, picture.height_px);
    const double scale = std::max(1.0, static_cast<double>(side) / kSearchedSide_px);
    const auto small =
        to_dlib(scale > 1 ? facet::render::resize(picture, static_cast<int>(picture.width_px / scale),
                                                  static_cast<int>(picture.height_px / scale))
                          : picture);
    std::vector<std::pair<double, dlib::rectangle>> faces;
    detector_(small, faces);
    if (faces.empty()) {
      return std::nullopt;
    }
    const auto best = std::max_element(faces.begin(), faces.end(),
                                       [](const auto& a, const auto& b) { return a.first < b.first; });
    const auto place = [&](long v) { return static_cast<long>(static_cast<double>(v) * scale); };
    const dlib::rectangle& box = best->second;
    const dlib::full_object_detection shape = predictor_(
        to_dlib(picture), {place(box.left()), place(box.top()), place(box.right()), place(box.bottom())});
    Face face{best->first, {}};
    for (int i = 0; i < kLandmarks; ++i) {
      const auto& point = shape.part(static_cast<unsigned long>(i));
      face.points_px.col(i) = Eigen::Vector2f(static_cast<float>(point.x()), static_cast<float>(point.y()));
    }
    return face;
  }

 private:
  static dlib::array2d<dlib::rgb_pixel> to_dlib(const facet::render::Picture& picture) {
    dlib::array2d<dlib::rgb_pixel> image(picture.height_px, picture.width_px);
    const std::uint8_t* rgb = picture.rgb.data();
    for (long y = 0; y < image.nr(); ++y) {
      for (long x = 0; x < image.nc(); ++x, rgb += 3) {
        image[y][x] = {rgb[0], rgb[1], rgb[2]};
      }
    }
    return image;
  }

  dlib::frontal_face_detector detector_;
  dlib::shape_predictor predictor_;
};

/// A surface in the camera frame; empty where there is none.
struct Surface {
  CameraIntrinsics camera;
  Vertices vertices_mm;
};

/// Distances of followed points from the detector's, percent of its distance of the outer eye corners.
struct Score {
  double sum = 0;
  int count = 0;
  std::array<double, kParts.size()> part_sum{};
  std::array<int, kParts.size()> part_count{};
  double percent() const { return count > 0 ? sum / count : 0; }
  double percent(std::size_t part) const {
    return part_count[part] > 0 ? part_sum[part] / part_count[part] : 0;
  }
};

/// Puts the landmarks of frame `good` on its surface and measures where they are in the others.
Score follow(const std::vector<std::optional<Points>>& seen, const std::vector<Surface>& surfaces,
             const Triangles& triangles, std::size_t good) {
  struct Attached {
    std::int32_t triangle = -1;
    Eigen::Vector2f barycentric{0, 0};
  };
  std::array<Attached, kLandmarks> attached;
  const Surface& first = surfaces[good];
  const facet::render::Raycaster caster(first.vertices_mm, triangles);
  for (int i = kFirst; i < kLandmarks; ++i) {
    const Eigen::Vector2f at = seen[good]->col(i);
    const Eigen::Vector3f ray((at.x() - first.camera.cx) / first.camera.fx,
                              (at.y() - first.camera.cy) / first.camera.fy, 1);
    const auto hit = caster.first_hit({0, 0, 0}, ray.normalized(), 0, true);
    attached[static_cast<std::size_t>(i)] = {hit.triangle, hit.barycentric};
  }
  Score score;
  for (std::size_t f = 0; f < seen.size(); ++f) {
    if (f == good || !seen[f] || surfaces[f].vertices_mm.cols() == 0) {
      continue;
    }
    const CameraIntrinsics& camera = surfaces[f].camera;
    const float eyes_px = (seen[f]->col(kRightEyeOuter) - seen[f]->col(kLeftEyeOuter)).norm();
    for (std::size_t part = 0; part < kParts.size(); ++part) {
      for (int i = kParts[part].first; i < kParts[part].end; ++i) {
        const Attached& point = attached[static_cast<std::size_t>(i)];
        if (point.triangle < 0) {
          continue;
        }
        const Eigen::Vector3f now =
            facet::render::interpolate(triangles, point.triangle, point.barycentric, surfaces[f].vertices_mm);
        const Eigen::Vector2f px(camera.fx * now.x() / now.z() + camera.cx,
                                 camera.fy * now.y() / now.z() + camera.cy);
        const auto percent = static_cast<double>(100 * (px - seen[f]->col(i)).norm() / eyes_px);
        score.sum += percent;
        ++score.count;
        score.part_sum[part] += percent;
        ++score.part_count[part];
      }
    }
  }
  return score;
}

Triangles triangles_of(const facet::mesh::Quads& quads) {
  Triangles triangles(3, 2 * quads.cols());
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    triangles.col(2 * q) << quads(0, q), quads(1, q), quads(2, q);
    triangles.col(2 * q + 1) << quads(0, q), quads(2, q), quads(3, q);
  }
  return triangles;
}

void print(const std::string& name, const char* what, const Score& score) {
  fmt::print("{:24} {:8} {:6.2f} |", name, what, score.percent());
  for (std::size_t part = 0; part < kParts.size(); ++part) {
    fmt::print(" {} {:.2f}", kParts[part].name, score.percent(part));
  }
  fmt::print(" | {} points\n", score.count);
}

void measure(const facet::face::FaceModel& model, Detector& detector, const Options& options,
             const std::filesystem::path& input) {
  const bool synthetic = std::filesystem::is_directory(input);
  const std::filesystem::path video = synthetic ? input / "video.mkv" : input;
  facet::track::TrackerConfig config;
  config.landmark_nets = options.assets;

  const auto each_frame = [&](const auto& work) {
    const auto camera = facet::camera::open_camera({.kind = "file", .path = video});
    camera->start();
    Frame frame;
    for (std::size_t f = 0; camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered;
         ++f) {
      if ((options.frames > 0 && f >= options.frames) || !work(frame, f)) {
        break;
      }
    }
  };
  facet::track::Tracker first(model, config);
  int width_px = 0, height_px = 0;
  each_frame([&](const Frame& frame, std::size_t) {
    width_px = frame.width_px;
    height_px = frame.height_px;
    first.process(frame);
    return !first.person().has_value();
  });
  first.settle_subject();
  if (!first.person()) {
    throw facet::Error(facet::ErrorKind::NoFace, input.string() + ": the tracker found no face");
  }
  facet::track::Tracker tracker(model, config);
  tracker.adopt(*first.person(), width_px, height_px);

  std::vector<std::optional<Points>> seen;
  std::vector<Surface> tracked, truth;
  Triangles true_triangles;
  nlohmann::json document;
  if (synthetic) {
    document = nlohmann::json::parse(std::ifstream(input / "camera.json"));
  }
  std::optional<std::size_t> good;
  double best_score = 0;
  each_frame([&](const Frame& frame, std::size_t f) {
    const facet::track::TrackResult& result = tracker.process(frame);
    if (f % static_cast<std::size_t>(options.every) != 0) {
      return true;
    }
    const auto face = detector.find(frame);
    seen.push_back(face ? std::optional(face->points_px) : std::nullopt);
    tracked.push_back({result.camera, {}});
    if (result.has_mesh) {
      tracked.back().vertices_mm = (result.camera_from_head.linear() * result.vertices_mm).colwise() +
                                   result.camera_from_head.translation();
    }
    if (synthetic) {
      auto mesh = facet::simulation::read_truth_ply(facet::simulation::truth_file(input, f));
      const auto number = [&](const char* key) { return document.at(key).get<float>(); };
      truth.push_back({{number("fx"), number("fy"), number("cx"), number("cy"), width_px, height_px},
                       std::move(mesh.vertices_mm)});
      true_triangles = std::move(mesh.triangles);
    }
    if (face && result.has_mesh && (!good || face->score > best_score)) {
      good = seen.size() - 1;
      best_score = face->score;
    }
    return true;
  });
  if (!good) {
    throw facet::Error(facet::ErrorKind::NoFace, input.string() + ": dlib found no face");
  }
  const std::string name = synthetic ? input.filename().string() : input.stem().string();
  const Triangles triangles = triangles_of(model.control.quads);
  print(name, "tracked", follow(seen, tracked, triangles, *good));
  const std::vector<Surface> held(tracked.size(), tracked[*good]);
  print(name, "held", follow(seen, held, triangles, *good));
  if (synthetic) {
    print(name, "truth", follow(seen, truth, true_triangles, *good));
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app(
      "Follows dlib's landmarks with points of the tracked surface; percent of the distance of the outer eye "
      "corners");
  Options options;
  app.add_option("--model", options.model, "face model")->capture_default_str();
  app.add_option("--landmark-nets", options.assets, "MediaPipe's packed nets")->capture_default_str();
  app.add_option("--predictor", options.predictor, "dlib's 68 landmarks (Debian: libdlib-data)")
      ->capture_default_str();
  app.add_option("--every", options.every, "frames from one measured frame to the next")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--frames", options.frames, "of each input, from its first on; 0: all")
      ->capture_default_str();
  app.add_option("inputs", options.inputs, "video clips, and folders that facet synth wrote")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    const auto model = facet::face::FaceModel::load(options.model);
    Detector detector(options.predictor);
    for (const auto& input : options.inputs) {
      measure(model, detector, options, input);
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "landmark_follow: {}\n", error.what());
    return 1;
  }
  return 0;
}
