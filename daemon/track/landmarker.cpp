#include "track/landmarker.hpp"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>
#include <opencv2/core/utility.hpp>

#include "track/face_detector.hpp"
#include "track/landmark_assets.hpp"
#include "track/landmark_net.hpp"

namespace facet::track {
namespace {

constexpr int right_eye_outer = 33;
constexpr int left_eye_outer = 263;
constexpr float window_scale = 1.5F;  ///< the landmark net was trained on windows of 1.5 face sizes

/// The window moves only where the face has left this much of play, and then only by the rest: noise does not
/// move it at all, motion moves it without delay, and nothing jumps.
constexpr float play_of_size = 0.03F;
constexpr float play_rad = 0.03F;

float milliseconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<float, std::milli>(std::chrono::steady_clock::now() - start).count();
}

float wrapped(float angle_rad) {
  return std::remainder(angle_rad, 2 * std::numbers::pi_v<float>);
}

/// The part of a difference that exceeds the play.
float beyond(float difference, float play) {
  return difference - std::clamp(difference, -play, play);
}

/// The window round the landmarks of a face: turned so that the outer eye corners lie level, 1.5 times the
/// longer side of the points' bounds in that orientation.
Region window_of(const Eigen::Matrix3Xf& points_px) {
  const Eigen::Vector2f eyes = (points_px.col(left_eye_outer) - points_px.col(right_eye_outer)).head<2>();
  Region window;
  window.rotation_rad = std::atan2(eyes.y(), eyes.x());
  const Eigen::Vector2f right = window.right();
  const Eigen::Vector2f down = window.down();
  Eigen::Array2f low = Eigen::Array2f::Constant(std::numeric_limits<float>::max());
  Eigen::Array2f high = -low;
  for (int i = 0; i < points_px.cols(); ++i) {
    const Eigen::Vector2f point = points_px.col(i).head<2>();
    const Eigen::Array2f turned(point.dot(right), point.dot(down));
    low = low.min(turned);
    high = high.max(turned);
  }
  const Eigen::Array2f middle = 0.5F * (low + high);
  window.centre_px = middle.x() * right + middle.y() * down;
  window.size_px = window_scale * (high - low).maxCoeff();
  return window;
}

bool usable(const Region& window) {
  // A window of a few pixels holds no face, and one of a million would overflow the arithmetic.
  return window.centre_px.allFinite() && std::isfinite(window.rotation_rad) && window.size_px > 4.0F &&
         window.size_px < 1e6F && window.centre_px.cwiseAbs().maxCoeff() < 1e6F;
}

/// The similarity (scale, rotation) that carries the canonical face to the landmarks (Horn 1987; Umeyama
/// 1991), and the error that remains.
void measure_shape(const CanonicalFace& canonical, FaceLandmarks& face) {
  constexpr float n = landmark_count;
  const Eigen::Vector3f mean = face.points_px.rowwise().mean();
  const Eigen::Vector3f canonical_mean = canonical.vertices_cm.rowwise().mean();
  Eigen::Matrix3f covariance = Eigen::Matrix3f::Zero();
  float canonical_variance = 0;
  float variance = 0;
  for (int i = 0; i < landmark_count; ++i) {
    const Eigen::Vector3f point = face.points_px.col(i) - mean;
    const Eigen::Vector3f source = canonical.vertices_cm.col(i) - canonical_mean;
    covariance += point * source.transpose();
    canonical_variance += source.squaredNorm();
    variance += point.squaredNorm();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3f> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3f signs = Eigen::Vector3f::Ones();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) {
    signs.z() = -1;
  }
  face.camera_from_canonical = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const float fitted = svd.singularValues().dot(signs);
  const float scale = fitted / canonical_variance;
  const Eigen::Vector3f eyes =
      canonical.vertices_cm.col(left_eye_outer) - canonical.vertices_cm.col(right_eye_outer);
  face.interocular_px = scale * eyes.norm();
  face.shape_error = std::sqrt(std::max(0.0F, variance - fitted * scale) / n) / face.interocular_px;
}

/// How far each landmark is seen: its place round the head against the line of sight, and whether it is in
/// the image. The place, not the surface normal: a nostril points down, yet the net sees it well from the
/// front.
void measure_confidence(const CanonicalFace& canonical, const Frame& frame, FaceLandmarks& face) {
  // Full confidence up to 65 degrees from the line of sight, none beyond 100: the net guesses hidden points.
  constexpr float full = 0.42F;
  constexpr float none = -0.17F;
  constexpr float axis_depth_cm = 4.0F;  ///< of the head's axis behind the mean of the face's points
  const Eigen::Vector3f mean = canonical.vertices_cm.rowwise().mean();
  const Eigen::RowVector3f towards_camera = -face.camera_from_canonical.row(2);
  face.confidence.resize(landmark_count);
  for (int i = 0; i < landmark_count; ++i) {
    const Eigen::Vector3f from_axis(canonical.vertices_cm(0, i) - mean.x(), 0,
                                    canonical.vertices_cm(2, i) - mean.z() + axis_depth_cm);
    const float facing = towards_camera * from_axis.normalized();
    const Eigen::Vector2f point = face.points_px.col(i).head<2>();
    const bool inside = point.x() >= -0.5F && point.y() >= -0.5F &&
                        point.x() <= static_cast<float>(frame.width_px) - 0.5F &&
                        point.y() <= static_cast<float>(frame.height_px) - 0.5F;
    face.confidence[i] = inside ? std::clamp((facing - none) / (full - none), 0.0F, 1.0F) : 0.0F;
  }
}

/// The windows of a search, coarse to fine: the whole image turned, then rows of overlapping tiles.
void list_search_windows(const Frame& frame, std::vector<Region>& windows) {
  constexpr float quarter = std::numbers::pi_v<float> / 2;
  constexpr float tile_step = 0.6F;  ///< of a tile: a face of 0.4 tiles lies whole in at least one
  const auto width = static_cast<float>(frame.width_px);
  const auto height = static_cast<float>(frame.height_px);
  const float short_side = std::min(width, height);
  windows.clear();
  const auto add_tiles = [&](float size, float rotation) {
    const auto count = [&](float extent) {
      return extent <= size ? 1 : 1 + static_cast<int>(std::ceil((extent - size) / (size * tile_step)));
    };
    const int columns = count(width);
    const int rows = count(height);
    const auto place = [&](float extent, int index, int number) {
      return number == 1 ? 0.5F * (extent - 1)
                         : 0.5F * (size - 1) +
                               (extent - size) * static_cast<float>(index) / static_cast<float>(number - 1);
    };
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        windows.push_back({{place(width, column, columns), place(height, row, rows)}, size, rotation});
      }
    }
  };
  const float whole = std::max(width, height);
  const float half = 0.5F * short_side;
  const bool has_short_level = short_side < whole;
  add_tiles(whole, 0);
  if (has_short_level) {
    add_tiles(short_side, 0);
  }
  for (const float rotation : {quarter, -quarter, 0.5F * quarter, -0.5F * quarter}) {
    add_tiles(whole, rotation);
  }
  add_tiles(half, 0);
  for (const float rotation : {quarter, -quarter}) {
    if (has_short_level) {
      add_tiles(short_side, rotation);
    }
    add_tiles(half, rotation);
  }
}

}  // namespace

struct Landmarker::Impl {
  Impl(const LandmarkAssets& assets, const std::string& name, const LandmarkerConfig& landmarker_config)
      : config(landmarker_config),
        canonical(parse_canonical_face(assets.geometry(), name + " (canonical face)")),
        detector(assets.detector(), name + " (face detector)"),
        net(assets.landmarks(), name + " (landmark net)") {}

  LandmarkerConfig config;
  CanonicalFace canonical;
  FaceDetector detector;
  LandmarkNet net;

  LandmarkResult result;
  bool following = false;  ///< the last frame had the face
  bool remembers = false;  ///< `window` is where a face was last
  Region window;           ///< where the followed or lost face is looked for next
  std::vector<Region> search_windows;
  std::size_t search_position = 0;
  int searched_width_px = 0;
  int searched_height_px = 0;
  std::vector<Detection> candidates;

  /// Runs the landmark net and judges what it gives.
  bool look(const Frame& frame, const Region& where, FaceLandmarks& face) {
    if (!usable(where)) {
      return false;
    }
    face.window = where;
    face.presence = net.find(frame, where, face.points_px);
    if (!face.points_px.allFinite()) {
      return false;
    }
    measure_shape(canonical, face);
    measure_confidence(canonical, frame, face);
    return face.presence >= config.min_presence && plausible(face);
  }

  bool plausible(const FaceLandmarks& face) const {
    constexpr float max_shape_error = 0.25F;
    constexpr float max_turn_in_window_rad = 1.0F;
    const Region next = window_of(face.points_px);
    return usable(next) && face.shape_error < max_shape_error &&
           std::abs(wrapped(next.rotation_rad - face.window.rotation_rad)) < max_turn_in_window_rad;
  }

  /// From a coarse detection to landmarks: the detector again on the crop, since its key points on small or
  /// turned faces can be wrong, until the face stands upright in its window; then the landmark net twice,
  /// since the first window is only the detector's.
  bool confirm(const Frame& frame, const Detection& coarse, FaceLandmarks& face) {
    constexpr int max_looks = 3;
    constexpr float upright_rad = 0.35F;
    Detection current = coarse;
    for (int i = 0; i < max_looks; ++i) {
      const Region closer = current.second_look();
      if (!usable(closer)) {
        return false;
      }
      const auto again = detector.detect(frame, closer, config.min_second_score);
      const auto nearest =
          std::min_element(again.begin(), again.end(), [&](const Detection& a, const Detection& b) {
            return (a.centre_px - coarse.centre_px).squaredNorm() <
                   (b.centre_px - coarse.centre_px).squaredNorm();
          });
      if (nearest == again.end() || (nearest->centre_px - coarse.centre_px).norm() > 0.5F * coarse.size_px) {
        return false;
      }
      current = *nearest;
      if (std::abs(wrapped(current.face_region().rotation_rad - closer.rotation_rad)) < upright_rad) {
        break;
      }
    }
    return look(frame, current.face_region(), face) && look(frame, window_of(face.points_px), face);
  }

  void move_window(const FaceLandmarks& face) {
    const Region target = window_of(face.points_px);
    const float play_px = play_of_size * target.size_px;
    const Eigen::Vector2f offset = target.centre_px - window.centre_px;
    window.centre_px += Eigen::Vector2f(beyond(offset.x(), play_px), beyond(offset.y(), play_px));
    window.size_px += beyond(target.size_px - window.size_px, play_px);
    window.rotation_rad =
        wrapped(window.rotation_rad + beyond(wrapped(target.rotation_rad - window.rotation_rad), play_rad));
  }

  bool follow(const Frame& frame) {
    if (!following || !look(frame, window, result.face)) {
      return false;
    }
    move_window(result.face);
    return usable(window);
  }

  /// Whether a detection may be the face that was lost: it can't have moved or grown at will. After a second
  /// of video anyone may be.
  bool may_be_lost_one(const Detection& face) const {
    constexpr int memory_frames = 30;
    constexpr float reach_sizes = 0.5F;
    constexpr float reach_sizes_per_frame = 0.05F;
    constexpr float growth = 1.4F;
    const int frames = result.frames_without_face;
    if (!remembers || frames > memory_frames) {
      return true;
    }
    const Region place = face.face_region();
    const float ratio = place.size_px / window.size_px;
    return (place.centre_px - window.centre_px).norm() <
               window.size_px * (reach_sizes + reach_sizes_per_frame * static_cast<float>(frames)) &&
           ratio < growth && ratio > 1 / growth;
  }

  /// Looks for faces in a window and takes the largest that holds up.
  bool acquire_in(const Frame& frame, const Region& where) {
    constexpr std::size_t max_attempts = 2;  ///< bounds the time of one window
    const auto faces = detector.detect(frame, where, config.min_detection_score);
    candidates.assign(faces.begin(), faces.end());
    std::erase_if(candidates, [&](const Detection& face) { return !may_be_lost_one(face); });
    std::sort(candidates.begin(), candidates.end(),
              [](const Detection& a, const Detection& b) { return a.size_px > b.size_px; });
    for (std::size_t i = 0; i < std::min(candidates.size(), max_attempts); ++i) {
      if (confirm(frame, candidates[i], result.face)) {
        window = window_of(result.face.points_px);
        return true;
      }
    }
    return false;
  }

  /// Looks near the last place, at the whole image, and in the next windows of the round.
  bool acquire(const Frame& frame) {
    constexpr float near_last = 2.0F;
    if (remembers && acquire_in(frame, {window.centre_px, near_last * window.size_px, window.rotation_rad})) {
      return true;
    }
    if (frame.width_px != searched_width_px || frame.height_px != searched_height_px) {
      searched_width_px = frame.width_px;
      searched_height_px = frame.height_px;
      list_search_windows(frame, search_windows);
      search_position = 0;
    }
    if (acquire_in(frame, search_windows.front())) {
      return true;
    }
    for (int i = 0; i < config.search_windows_per_frame; ++i) {
      search_position = search_position + 1 < search_windows.size() ? search_position + 1 : 1;
      if (acquire_in(frame, search_windows[search_position])) {
        return true;
      }
    }
    return false;
  }
};

Landmarker::Landmarker(const std::filesystem::path& assets, const LandmarkerConfig& config) {
  cv::setNumThreads(1);
  impl_ = std::make_unique<Impl>(LandmarkAssets::load(assets), assets.string(), config);
}
Landmarker::~Landmarker() = default;
Landmarker::Landmarker(Landmarker&&) noexcept = default;
Landmarker& Landmarker::operator=(Landmarker&&) noexcept = default;

const LandmarkResult& Landmarker::process(const Frame& frame) {
  LandmarkResult& result = impl_->result;
  result.found = false;
  result.acquired = false;
  result.detect_ms = 0;
  result.landmarks_ms = 0;
  if (!frame.empty() && !frame.corrupt && frame.width_px > 0 && frame.height_px > 0) {
    auto start = std::chrono::steady_clock::now();
    result.found = impl_->follow(frame);
    result.landmarks_ms = milliseconds_since(start);
    if (!result.found) {
      start = std::chrono::steady_clock::now();
      result.found = impl_->acquire(frame);
      result.acquired = result.found;
      result.detect_ms = milliseconds_since(start);
    }
  }
  impl_->following = result.found;
  impl_->remembers = impl_->remembers || result.found;
  result.frames_without_face = result.found ? 0 : result.frames_without_face + 1;
  return result;
}

void Landmarker::forget() {
  impl_->following = false;
  impl_->remembers = false;
}

std::vector<FaceLandmarks> Landmarker::find_all(const Frame& frame) {
  std::vector<FaceLandmarks> faces;
  if (frame.empty() || frame.width_px <= 0 || frame.height_px <= 0) {
    return faces;
  }
  std::vector<Region> windows;
  list_search_windows(frame, windows);
  for (const Region& where : windows) {
    const auto seen = impl_->detector.detect(frame, where, impl_->config.min_detection_score);
    const std::vector<Detection> candidates(seen.begin(), seen.end());
    for (const Detection& candidate : candidates) {
      FaceLandmarks face;
      const auto same_place = [](const Region& a, const Region& b) {
        return (a.centre_px - b.centre_px).norm() < 0.3F * std::max(a.size_px, b.size_px);
      };
      const auto known = [&](const Region& place) {
        return std::any_of(faces.begin(), faces.end(),
                           [&](const FaceLandmarks& other) { return same_place(other.window, place); });
      };
      if (!known(candidate.face_region()) && impl_->confirm(frame, candidate, face) && !known(face.window)) {
        faces.push_back(std::move(face));
      }
    }
  }
  std::sort(faces.begin(), faces.end(), [](const FaceLandmarks& a, const FaceLandmarks& b) {
    return a.window.size_px > b.window.size_px;
  });
  return faces;
}

const CanonicalFace& Landmarker::canonical() const {
  return impl_->canonical;
}

}  // namespace facet::track
