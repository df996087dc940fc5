#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "mesh/arkit.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::avatar {

/// What an avatar is moved by: one frame's expression and head.
struct FaceState {
  std::uint64_t sequence = 0;
  std::int64_t timestamp_ns = 0;  ///< CLOCK_MONOTONIC
  bool tracked = false;           ///< without a face the rest is as it was last
  bool provisional = false;       ///< of a face that is still being got to know
  bool has_expression = false;    ///< false: meshes without expressions (a booth's); all values are 0
  mesh::ArkitValues values{};
  /// x right, y up, z towards the viewer, metres; no turn where the face looks straight at the camera.
  Eigen::Isometry3f upright_from_head = Eigen::Isometry3f::Identity();
};

/// The state that a frame shows, its values as measured; tracked where it has a mesh.
FaceState face_state(const mesh::MeshFrame& frame);
/// [expression_count] the state's values in the order of the frame's expressions; those that ARKit does not
/// have are the frame's own. Needs frame.subject.
void values_to_frame(const mesh::ArkitValues& values, mesh::MeshFrame& frame);

/// A person's resting face and the pose that counts as straight ahead.
struct NeutralPose {
  mesh::ArkitValues values{};
  Eigen::Isometry3f upright_from_head = Eigen::Isometry3f::Identity();
};

/// Takes the resting face away: a value runs from 0 at rest to 1 as before.
void subtract_values(const NeutralPose& neutral, FaceState& state);
/// The head's turn and place become those against the neutral pose, in its own axes.
void subtract_head(const NeutralPose& neutral, FaceState& state);

/// The mean of the states of a while.
class NeutralRecorder {
 public:
  /// So many tracked frames at least make a neutral pose.
  static constexpr int kFewestFrames = 10;

  /// Provisional states do not count.
  void add(const FaceState& state);
  int frames() const { return frames_; }
  /// Nothing where there were too few frames.
  std::optional<NeutralPose> mean() const;

 private:
  int frames_ = 0;
  mesh::ArkitValues sums_{};
  Eigen::Vector3f translations_ = Eigen::Vector3f::Zero();
  Eigen::Matrix4f turns_ = Eigen::Matrix4f::Zero();  ///< sum of q q^T [MCCO07]
};

/// A neutral pose as a JSON file: "facet_neutral": 1, "values" {name: value}, "rotation" [x, y, z, w],
/// "translation_m". Throws Error(Storage) naming the file.
void save_neutral(const NeutralPose& neutral, const std::filesystem::path& file);
inline constexpr std::size_t kMostNeutralBytes = 1U << 16;
/// Reads what save_neutral writes; source names it in messages. Throws Error(UnreadableInput).
NeutralPose parse_neutral(std::string_view text, const std::string& source);
/// Nothing where there is no file. Throws Error(UnreadableInput) naming it where it can't be used.
std::optional<NeutralPose> load_neutral(const std::filesystem::path& file);

/// Exponential smoothing of states as they come.
class Smoother {
 public:
  /// time_constant_s: after so long 63 % of a step have come through; 0: no smoothing.
  explicit Smoother(float time_constant_s) : time_constant_s_(time_constant_s) {}
  /// Begins anew after a pause without a face.
  void apply(FaceState& state);

 private:
  float time_constant_s_;
  std::optional<FaceState> before_;
};

}  // namespace facet::avatar
