#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "face/face_model.hpp"
#include "facet/frame.hpp"
#include "track/tracker.hpp"

namespace facet::person {

/// The part of a picture that shows the head, copied: a camera's own pictures go back to their pool.
struct HeadPicture {
  int left_px = 0;  ///< of the whole picture
  int top_px = 0;
  int width_px = 0;
  int height_px = 0;
  std::vector<std::uint8_t> rgb;  ///< [height_px][width_px][3] sRGB
};

/// The part of a picture that holds the mesh tracked in it, and a margin.
HeadPicture head_picture(const Frame& picture, const track::TrackResult& tracked);

/// A head as it was seen and tracked at one moment.
struct Keyframe {
  std::uint64_t sequence = 0;
  Eigen::Isometry3d camera_from_head = Eigen::Isometry3d::Identity();  ///< mm
  Eigen::VectorXd expression;                                          ///< [expression_count] as tracked
  double yaw_deg = 0;    ///< from where in the head's axes the camera looks: to the head's left positive
  double pitch_deg = 0;  ///< from above positive
  double reprojection_px = 0;
  double speed_deg_s = 0;  ///< of the head's turning
  int light = 0;           ///< 0: the room's; of a burst which of its lights, from 1 on
  HeadPicture picture;
};

/// The whole picture of which a keyframe holds the head, black around it; for people and programs that look
/// at whole ones. camera  with the size of its pictures
Frame picture_of(const Keyframe& keyframe, const CameraIntrinsics& camera);

/// The widest angles that were seen: yaw to both sides, pitch down and up, degrees.
struct OrientationSpan {
  double least_yaw = 0, largest_yaw = 0, least_pitch = 0, largest_pitch = 0;
};

/// What a tracked head showed so far, as its shape is to be learned from it.
struct Observed {
  CameraIntrinsics camera;      ///< focal length as the tracker took it
  std::vector<float> identity;  ///< [identity_count] as the tracker took it
  Eigen::VectorXd rest;         ///< [expression_count] median of the tracked expressions
  double usual_reprojection_px = 0;
  std::vector<Keyframe> keyframes;  ///< in the order of time
  OrientationSpan span;             ///< of all that was kept
  std::vector<Keyframe> burst;      ///< the still head while lamps fired in turn; may be empty

  /// How many lights the burst's pictures tell apart.
  int light_count() const;
};

/// Keeps of a tracked head the calmest picture for each orientation, in bins of 4 degrees of yaw and 5 of
/// pitch (docs/person.md, "Keyframes"), and the pictures of a burst. Bounded: 200 bins, 256 MB of pictures
/// and as much of a burst's, whose first 2,000 frames count, 3,000 frames' expressions. One thread.
class KeyframeCollector {
 public:
  /// model must outlive the collector.
  explicit KeyframeCollector(const face::FaceModel& model);

  /// The next tracked frame and the picture that it was tracked in. Frames that have no settled mesh and
  /// blurred ones are passed over; another subject begins anew. 10 microseconds, and half a millisecond where
  /// a picture is kept.
  void offer(const track::TrackResult& tracked, const Frame& picture);

  /// The next frame of a burst: the head is still while lamps fire in turn. Where there is no room for all
  /// pictures every second one is kept, then every fourth, and so on.
  void offer_lit(const track::TrackResult& tracked, const Frame& picture);
  /// Forgets the burst.
  void clear_lit();

  /// Forgets everything.
  void clear();

  std::size_t size() const { return bins_.size(); }
  /// Of all that is kept.
  OrientationSpan span() const;
  /// The bins that are filled: (yaw, pitch) of their middles, degrees.
  std::vector<std::pair<double, double>> filled() const;

  /// At most `most` keyframes of a face about at rest, thinned out where they are dense; nothing where no
  /// frame counted. Of the burst at most `most_lit` pictures of the face at rest, the head where it was most
  /// of the time: first one of every light, each time the one that is farthest from those taken, then others
  /// of them. A light counts where two frames in a row show it: a lamp that is switched within an exposure
  /// lights a part of a picture.
  std::optional<Observed> observed(int most, int most_lit = 0) const;

 private:
  double restlessness(const Eigen::VectorXd& expression, const Eigen::VectorXd& rest) const;
  double cost(const Keyframe& keyframe, const Eigen::VectorXd& rest) const;
  void begin_unless_same(const track::TrackResult& tracked);
  std::vector<Keyframe> burst(int most, const Eigen::VectorXd& rest) const;

  const face::FaceModel* model_;
  std::vector<char> moves_;  ///< [expression_count] it moves skin: not the eyes' looking about
  std::uint32_t subject_ = 0;
  CameraIntrinsics camera_;
  std::vector<float> identity_;
  std::map<std::pair<int, int>, Keyframe> bins_;
  std::size_t picture_bytes_ = 0;
  /// A frame of a burst.
  struct Lit {
    Keyframe keyframe;      ///< without a picture where there was no room
    Eigen::ArrayXf fields;  ///< mean brightness of the picture's
  };
  std::vector<Lit> lit_;
  std::size_t lit_bytes_ = 0;
  std::size_t lit_step_ = 1;                  ///< every so many-th frame of the burst keeps its picture
  std::vector<Eigen::VectorXf> expressions_;  ///< of all frames that counted, the last 3,000
  std::size_t next_expression_ = 0;
  std::vector<float> reprojections_px_;
  Eigen::VectorXd mean_expression_;
  std::optional<std::pair<std::int64_t, Eigen::Matrix3f>> previous_;  ///< time and turn of the frame before
};

/// Where the camera stands in the head's axes: yaw and pitch, degrees.
std::pair<double, double> orientation_deg(const Eigen::Isometry3d& camera_from_head);

}  // namespace facet::person
