#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <memory>
#include <vector>

#include "facet/frame.hpp"
#include "landmark/canonical_face.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// The landmarks of one face in one frame: MediaPipe's 468 face mesh points in its order. Image coordinates
/// are x right, y down with pixel centres at integers.
struct FaceLandmarks {
  /// [3][468] x, y in image pixels, also outside the image; z in the same scale, away from the camera, 0 near
  /// the middle of the head. z is the net's guess, not a measurement.
  Eigen::Matrix3Xf points_px;
  /// [468] 0 to 1: how far the point is seen. 1 faces the camera; falls to 0 where the face turns away from
  /// it or the point lies outside the image. Multiply a landmark's weight with it.
  Eigen::VectorXf confidence;
  /// [3][2] centres of the subject's right and left iris, x and y in image pixels, z 0; empty where nobody
  /// looked for them.
  Eigen::Matrix3Xf irises_px;
  /// 0 to 1, right and left: how far the iris is seen. 0 behind a closed lid, where the net guesses.
  std::array<float, 2> iris_confidence{};
  float presence = 0;  ///< the landmark net's probability that its window holds a face
  /// rms distance, in interocular distances, of the seen points from where the net with attention sees them;
  /// 0 where only one net looked. 0.01 to 0.04 on faces that both nets see well; more on heads that are
  /// turned further than the nets can follow, where each guesses in its own way.
  float contradiction = 0;
  /// rms distance to the canonical face after the best similarity, in interocular distances.
  float shape_error = 0;
  Eigen::Matrix3f camera_from_canonical = Eigen::Matrix3f::Identity();  ///< rotation of that similarity
  float interocular_px = 0;  ///< distance of the outer eye corners by that similarity: not foreshortened
  Region window;             ///< where the net looked
};

/// A landmark's place in image pixels. landmark: an index of the face mesh, or kRightIris, kLeftIris where
/// irises_px is not empty.
inline Eigen::Vector3f place_of(const FaceLandmarks& face, int landmark) {
  return landmark < landmark_count ? face.points_px.col(landmark)
                                   : face.irises_px.col(landmark - landmark_count);
}

/// How far a landmark is seen, 0 to 1; 0 for an iris that nobody looked for.
inline float confidence_of(const FaceLandmarks& face, int landmark) {
  if (landmark < landmark_count) {
    return face.confidence[landmark];
  }
  return face.irises_px.cols() == 0
             ? 0.0F
             : face.iris_confidence[static_cast<std::size_t>(landmark - landmark_count)];
}

struct LandmarkerConfig {
  /// Lips, lids and irises from the net with attention; without it those of the plain net, and no irises.
  bool attends = true;
  float min_detection_score = 0.5F;  ///< of the first, coarse look
  float min_second_score = 0.6F;     ///< of the second look, close and upright
  float min_presence = 0.5F;
  /// Windows that one frame may add to the look at the whole image while no face is found; the search for
  /// small and turned faces goes round through the frames. About 3 ms each.
  int search_windows_per_frame = 3;
  /// Filter the landmarks of a sequence over time (landmark/landmark_filter.hpp): less jitter, lag below 0.1
  /// frames.
  bool smooth = true;
  /// No frame waits for the detector while a face is followed: what it says counts once it is there. Where
  /// this is off it counts at a fixed frame, so that a sequence gives the same bits in every run.
  bool live = false;
};

struct LandmarkResult {
  bool found = false;           ///< false: `face` is left over from the last frame that had one
  bool acquired = false;        ///< the face was found by the detector in this frame, not followed into it
  int frames_without_face = 0;  ///< up to this one; 0 where found
  FaceLandmarks face;
  float detect_ms = 0;
  float landmarks_ms = 0;
};

/// Finds one face and follows it through a sequence of frames. One thread at a time; after the first frames
/// it allocates nothing. Work runs on the calling thread, but for the
/// detector's check of a followed face, on a helper thread of low priority, `facet-detect`, which the first
/// check makes and the destructor ends. The constructor sets cv::setNumThreads(1) for the whole process, so
/// that OpenCV's pool never competes with the GPU driver's threads.
class Landmarker {
 public:
  /// assets: face_mesh_solution_packed_assets.data. Throws Error(UnreadableInput) where it is missing or
  /// damaged.
  explicit Landmarker(const std::filesystem::path& assets, const LandmarkerConfig& config = {});
  ~Landmarker();
  Landmarker(Landmarker&&) noexcept;
  Landmarker& operator=(Landmarker&&) noexcept;

  /// The next frame of a sequence. Follows the face of the last frame in a window that its landmarks give.
  /// Another face that comes before it or near it is not taken for it: its looks are compared with the
  /// followed one's, and the detector confirms the place of every tenth frame while the next ones are
  /// followed. A lost face is looked for everywhere, but for 25 frames only a face that looks like it is
  /// accepted; then the largest face is taken. Any size and content of frame; an empty or corrupt one counts
  /// as a frame without a face. Never throws. Valid until the next call.
  const LandmarkResult& process(const Frame& frame);

  /// Forgets the face; the next frame is searched for the largest one.
  void forget();

  /// Every face of a still image, largest first, upright or turned by up to 90 degrees: looks at the whole
  /// image and at overlapping tiles of a half of its short side. Does not touch the sequence. Allocates; up
  /// to 0.3 s.
  std::vector<FaceLandmarks> find_all(const Frame& frame);

  /// The face that the landmark indices refer to.
  const CanonicalFace& canonical() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::landmark
