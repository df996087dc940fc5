#include "landmark/landmarker.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <opencv2/core/utility.hpp>
#include <optional>

#include "facet/clock.hpp"
#include "landmark/appearance.hpp"
#include "landmark/attention_net.hpp"
#include "landmark/face_check.hpp"
#include "landmark/face_detector.hpp"
#include "landmark/face_geometry.hpp"
#include "landmark/face_picture.hpp"
#include "landmark/landmark_assets.hpp"
#include "landmark/landmark_filter.hpp"
#include "landmark/landmark_layout.hpp"
#include "landmark/landmark_net.hpp"
#include "landmark/search_plan.hpp"

namespace facet::landmark {
namespace {

/// The window moves only where the face has left this much of play, and then only by the rest: noise does not
/// move it at all, motion moves it without delay, and nothing jumps.
constexpr float play_of_size = 0.03F;
constexpr float play_rad = 0.03F;

// Likeness of a face to the slow average of the followed one.
constexpr float surely_same = 0.85F;
constexpr float maybe_same = 0.78F;
constexpr float average_rate = 0.05F;

/// How long a lost face is waited for: after that anyone may be the one.
constexpr int memory_frames = 25;

/// The part of a difference that exceeds the play.
float beyond(float difference, float play) {
  return difference - std::clamp(difference, -play, play);
}

/// Moves a window after a face, with play.
void follow_with_play(const Region& target, Region& window) {
  const float play_px = play_of_size * target.size_px;
  const Eigen::Vector2f offset = target.centre_px - window.centre_px;
  window.centre_px += Eigen::Vector2f(beyond(offset.x(), play_px), beyond(offset.y(), play_px));
  window.size_px += beyond(target.size_px - window.size_px, play_px);
  const float turn = wrapped(target.rotation_rad - window.rotation_rad);
  window.rotation_rad = wrapped(window.rotation_rad + beyond(turn, play_rad));
}

/// Whether two windows may hold one face: centres within `reach` sizes of the second, sizes within a factor.
bool near_each_other(const Region& a, const Region& b, float reach, float growth) {
  const float ratio = a.size_px / b.size_px;
  return (a.centre_px - b.centre_px).norm() < reach * b.size_px && ratio < growth && ratio * growth > 1;
}

}  // namespace

struct Landmarker::Impl {
  Impl(const LandmarkAssets& assets, const std::string& name, const LandmarkerConfig& landmarker_config)
      : config(landmarker_config),
        canonical(parse_canonical_face(assets.geometry(), name + " (canonical face)")),
        detector(assets.detector(), name + " (face detector)"),
        net(assets.landmarks(), name + " (landmark net)"),
        attention(assets.attention_landmarks(), name + " (landmark net with attention)"),
        check(assets.detector(), name + " (face detector)", landmarker_config.min_second_score) {}

  LandmarkerConfig config;
  CanonicalFace canonical;
  FaceDetector detector;
  LandmarkNet net;
  AttentionNet attention;

  LandmarkResult result;
  LandmarkFilter filter;
  LandmarkFilter iris_filter;
  std::int64_t last_media_time_ns = 0;
  bool following = false;        ///< the last frame had the face
  bool remembers = false;        ///< `window`, `trusted` and `average` tell of a face
  Region window;                 ///< where the face is looked for next
  Region trusted;                ///< where it was when it last surely was itself
  Eigen::Matrix3Xf attended_px;  ///< [3][468] of the net with attention
  Eigen::VectorXf appearance;
  Eigen::VectorXf average;     ///< of the followed face's appearance
  int foreign_frames = 0;      ///< frames running in which it looked like another
  int conflicts = 0;           ///< checks running in which the detector saw it elsewhere
  int frames_since_check = 0;  ///< since the last question to `check`

  std::vector<Detection> candidates;
  std::vector<Region> search_windows;
  std::size_t search_position = 0;
  int searched_width_px = 0;
  int searched_height_px = 0;

  FaceCheck check;
  FacePicture picture;  ///< of the face's window, once a face was found

  /// Runs the landmark net and judges what it gives.
  bool look(const Frame& frame, const Region& where, FaceLandmarks& face) {
    constexpr float max_shape_error = 0.2F;
    constexpr float max_turn_in_window_rad = 1.0F;
    if (!usable(where)) {
      return false;
    }
    face.window = where;
    picture.sample(frame, where);
    face.presence = net.find(picture, face.points_px);
    if (!face.points_px.allFinite()) {
      return false;
    }
    measure_shape(canonical, face);
    measure_confidence(canonical, frame, face);
    const Region next = window_of(face.points_px);
    return face.presence >= config.min_presence && usable(next) && face.shape_error < max_shape_error &&
           std::abs(wrapped(next.rotation_rad - where.rotation_rad)) < max_turn_in_window_rad;
  }

  /// Takes lips, eyes and irises from the net with attention where it sees the face too; on profiles it often
  /// does not, while the plain net goes on. `picture` is the face's.
  void refine(const Frame& frame, FaceLandmarks& face) {
    face.contradiction = 0;
    if (!config.attends) {
      return;
    }
    const float presence = attention.find(picture, attended_px, face.irises_px);
    if (!attended_px.allFinite() || !face.irises_px.allFinite()) {
      face.irises_px.setZero();
      face.iris_confidence = {};
      return;
    }
    measure_contradiction(attended_px, face);
    for (const auto& part : {lip_landmarks(), right_eye_landmarks().first(kLidLandmarks),
                             left_eye_landmarks().first(kLidLandmarks)}) {
      for (const int landmark : part) {
        face.points_px.col(landmark).head<2>() +=
            presence * (attended_px.col(landmark) - face.points_px.col(landmark)).head<2>();
      }
    }
    measure_confidence(canonical, frame, face);
    measure_iris_confidence(face);
    for (float& confidence : face.iris_confidence) {
      confidence *= presence;
    }
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
      const auto nearest = nearest_to(coarse.centre_px, again);
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

  bool follow(const Frame& frame) {
    if (!following) {
      return false;
    }
    if (!look(frame, window, result.face)) {
      return false;
    }
    if (taken_over(frame) || misplaced(frame)) {
      window = trusted;
      return false;
    }
    follow_with_play(window_of(result.face.points_px), window);
    return usable(window);
  }

  /// Whether another face has come before the followed one: it looks different for some frames and has moved
  /// or grown. A face that only looks different stands in new light or behind a hand.
  bool taken_over(const Frame& frame) {
    constexpr int patience_frames = 3;
    constexpr float still_reach = 0.15F;
    constexpr float still_growth = 1.15F;
    measure_appearance(frame, result.face, appearance);
    const float same = likeness(appearance, average, result.face.confidence);
    if (same < maybe_same &&
        !near_each_other(window_of(result.face.points_px), trusted, still_reach, still_growth)) {
      return ++foreign_frames >= patience_frames;
    }
    foreign_frames = 0;
    average += average_rate * (appearance - average);
    if (same >= surely_same && conflicts == 0) {
      trusted = window;
    }
    return false;
  }

  /// Whether the detector sees the face elsewhere: the landmark net reports full presence on a window that
  /// has slipped between two faces. It looks every few frames, sooner where the shape is odd, at a frame that
  /// is then past: its answer comes some frames later. A detector that sees nothing proves nothing: it knows
  /// neither profiles nor half-hidden faces.
  bool misplaced(const Frame& frame) {
    constexpr int check_frames = 10;
    constexpr int hasty_check_frames = 3;
    constexpr float odd_shape = 0.09F;  ///< real faces with strong expressions stay below
    constexpr int patience_checks = 2;
    ++frames_since_check;
    if (check.pending() && answer_is_due()) {
      take_answer();
    }
    if (!check.pending() &&
        frames_since_check >= (result.face.shape_error > odd_shape ? hasty_check_frames : check_frames)) {
      frames_since_check = 0;
      check.ask(frame, window_of(result.face.points_px));
    }
    return conflicts >= patience_checks;
  }

  /// Frames that must not wait take an answer once it is there; one that never comes is waited for at last.
  bool answer_is_due() {
    constexpr int answer_frames = 2;
    constexpr int overdue_frames = 30;
    return frames_since_check >= answer_frames &&
           (!config.live || check.ready() || frames_since_check >= overdue_frames);
  }

  void take_answer() {
    // The detector's windows are 0.76 to 1.06 of the landmarks', their centres within 0.13 sizes.
    constexpr float usual_ratio = 0.9F;
    constexpr float reach = 0.25F;
    constexpr float growth = 1.4F;
    const auto start = Clock::now();
    Region place = check.place();
    place.size_px *= usual_ratio;
    if (const std::optional<Region> seen = check.answer()) {
      conflicts = near_each_other(*seen, place, reach, growth) ? 0 : conflicts + 1;
    }
    result.detect_ms += ms_since(start);
  }

  bool waits_for_lost_face() const { return remembers && result.frames_without_face < memory_frames; }

  /// Whether a detection may be the face that was lost: it can't have moved or grown at will.
  bool may_be_lost_one(const Region& place) const {
    constexpr float reach = 0.5F;
    constexpr float reach_per_frame = 0.05F;
    constexpr float growth = 1.5F;
    return near_each_other(place, window,
                           reach + reach_per_frame * static_cast<float>(result.frames_without_face), growth);
  }

  /// Looks for faces in a window and takes the one nearest to the lost face, or else the largest, that holds
  /// up.
  bool acquire_in(const Frame& frame, const Region& where) {
    constexpr std::size_t max_attempts = 2;  ///< bounds the time of one window
    const auto faces = detector.detect(frame, where, config.min_detection_score);
    candidates.assign(faces.begin(), faces.end());
    std::sort(candidates.begin(), candidates.end(), [&](const Detection& a, const Detection& b) {
      return waits_for_lost_face() ? (a.centre_px - window.centre_px).squaredNorm() <
                                         (b.centre_px - window.centre_px).squaredNorm()
                                   : a.size_px > b.size_px;
    });
    for (std::size_t i = 0; i < std::min(candidates.size(), max_attempts); ++i) {
      if (confirm(frame, candidates[i], result.face) && accept(frame)) {
        return true;
      }
    }
    return false;
  }

  /// Takes a confirmed face, unless it is plainly not the one that is waited for.
  bool accept(const Frame& frame) {
    measure_appearance(frame, result.face, appearance);
    const Region place = window_of(result.face.points_px);
    if (waits_for_lost_face()) {
      const float same = likeness(appearance, average, result.face.confidence);
      if (same < (may_be_lost_one(place) ? maybe_same : surely_same)) {
        return false;
      }
    } else {
      average = appearance;
    }
    window = place;
    trusted = place;
    foreign_frames = 0;
    conflicts = 0;
    frames_since_check = 0;
    check.drop();
    return true;
  }

  /// Calms the landmarks of a face that was found.
  void smooth(const Frame& frame) {
    constexpr float usual_frame_seconds = 1 / 30.0F;
    constexpr float longest_frame_seconds = 0.5F;
    const auto passed_ns = static_cast<float>(frame.media_time_ns - last_media_time_ns);
    const float seconds = passed_ns > 0 ? 1e-9F * passed_ns : usual_frame_seconds;
    if (result.acquired || seconds > longest_frame_seconds) {
      filter.reset();
      iris_filter.reset();
    }
    iris_filter.apply(result.face.interocular_px, seconds, result.face.irises_px);
    filter.apply(result.face.interocular_px, seconds, result.face.points_px);
    last_media_time_ns = frame.media_time_ns;
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
      list_search_windows(frame.width_px, frame.height_px, search_windows);
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
    auto start = Clock::now();
    result.found = impl_->follow(frame);
    result.landmarks_ms = ms_since(start) - result.detect_ms;
    if (!result.found) {
      start = Clock::now();
      result.found = impl_->acquire(frame);
      result.acquired = result.found;
      result.detect_ms += ms_since(start);
    }
  }
  if (result.found) {
    const auto start = Clock::now();
    impl_->refine(frame, result.face);
    result.landmarks_ms += ms_since(start);
    if (impl_->config.smooth) {
      impl_->smooth(frame);
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
  list_search_windows(frame.width_px, frame.height_px, windows);
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
  for (FaceLandmarks& face : faces) {
    impl_->picture.sample(frame, face.window);
    impl_->refine(frame, face);
  }
  std::sort(faces.begin(), faces.end(), [](const FaceLandmarks& a, const FaceLandmarks& b) {
    return a.window.size_px > b.window.size_px;
  });
  return faces;
}

const CanonicalFace& Landmarker::canonical() const {
  return impl_->canonical;
}

}  // namespace facet::landmark
