#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "animate/face_graph.hpp"
#include "animate/face_ik.hpp"
#include "animate/influence.hpp"
#include "animate/keys_file.hpp"

namespace facet::animate {

/// One region's way through captured faces over time. Faces that follow each other in the take are sampled by
/// a cubic spline of their coefficients (which is the spline of every vertex: both are linear in the faces);
/// at a jump the two runs of faces are blended over kFade_s while both play on.
class Track {
 public:
  /// faces: as TakeBasis::frames, one per step_s from begin_s on. mm and seconds throughout.
  Track(const TakeBasis& basis, const std::vector<std::int32_t>& faces, double begin_s, double step_s);

  /// The region's state at a time, held before the first and after the last face.
  Eigen::VectorXf state(const TakeBasis& basis, double time_s) const;

  static constexpr double kFade_s = 0.25;

 private:
  struct Run {
    double first_face = 0;  ///< at begin_s
    double begin_s = 0;
    double end_s = 0;
    double lowest = 0;  ///< faces that the take has without a gap around the run
    double highest = 0;
    double fade_middle_s = 0;  ///< from the run before to this one
    double fade_half_s = 0;
  };
  Eigen::VectorXf sample(const TakeBasis& basis, const Run& run, double time_s) const;

  std::vector<Run> runs_;
  double step_s_;
};

/// What filling the time between two keys in one region took.
struct TransitionReport {
  std::size_t key = 0;  ///< the first of the two, counted from 0
  int region = 0;
  double cost = 0;           ///< of the path, mm (FaceGraph::Path)
  double shortest_cost = 0;  ///< of the cheapest path, whatever its length
  double direct_cost = 0;    ///< of linear interpolation
  int faces = 0;
  int jumps = 0;
  float worst_cost = 0;           ///< of its most expensive step
  std::uint64_t worst_frame = 0;  ///< where that begins, MeshFrame::sequence
  float key_offset_mm = 0;        ///< from the key's pose to the nearest captured face, rms over the region
  double speed = 1;               ///< of the captured one
};

struct AnimationReport {
  std::vector<TransitionReport> transitions;
  std::vector<std::string> warnings;  ///< control points that were not met or lie outside what was captured
  int jumps = 0;                      ///< of a walk
  float worst_jump_cost = 0;          ///< of a walk, mm
  std::uint64_t worst_jump_frame = 0;
};

/// The mean face with its mean displacements: where vertices rest. Head frame, mm. [3][finest_count]
mesh::Vertices resting_vertices(const TakeBasis& basis);

/// A key's control point as FaceIk takes it; rest_mm: resting_vertices. Throws Error(Usage) where there is no
/// such vertex.
ControlTarget control_target(const TakeBasis& basis, const KeyControl& control,
                             const mesh::Vertices& rest_mm);

/// How the head is held.
enum class HeadMotion : std::uint8_t {
  Still,     ///< as in the sample frame
  Captured,  ///< as in the take, forwards and backwards
};

struct WalkOptions {
  double duration_s = 30;
  std::uint64_t seed = 1;
  double mean_run_s = 2.5;            ///< between jumps
  std::vector<std::int32_t> regions;  ///< vertices; none: the whole face walks as one
};

/// A face over time. Immutable; any thread.
class Animation {
 public:
  /// Data-driven key frames [SF04 sec. 5.3]: each key's pose is solved by FaceIk, each
  /// region goes from the captured face nearest to one key to that of the next on a path of its face graph,
  /// and what keys differ from captured faces is added, fading from one key to the next: keys are met
  /// exactly, control points too. Takes long: go_on breaks it off. Control points may differ from key to key:
  /// one that a key lacks follows that key's other ones. Throws as FaceIk does, naming the key, and
  /// Error(Usage) where a key's frame is not in the take.
  static Animation of_keys(const std::shared_ptr<const TakeBasis>& basis, const KeyList& keys,
                           AnimationReport& report, const GoOn& go_on = {});

  /// A random walk [SF04 sec. 5.2], with regions one of its own in each. Throws Error(Usage) where options
  /// make no sense.
  static Animation of_walk(const std::shared_ptr<const TakeBasis>& basis, const WalkOptions& options,
                           AnimationReport& report, const GoOn& go_on = {});

  double duration_s() const { return duration_s_; }
  const TakeBasis& basis() const { return *basis_; }

  /// The pose at a time from 0 to duration_s.
  void pose(double time_s, Pose& out) const;
  Eigen::Isometry3f camera_from_head(double time_s, HeadMotion motion) const;

 private:
  /// Between two keys, in one region.
  struct Interval {
    double begin_s = 0;
    double end_s = 0;
    Track track;
    Eigen::VectorXf offset_before;
    Eigen::VectorXf offset_after;
  };
  Animation() = default;

  std::shared_ptr<const TakeBasis> basis_;
  std::shared_ptr<const InfluenceMaps> maps_;
  double duration_s_ = 0;
  std::vector<std::vector<Interval>> regions_;  ///< [region_count], each in the order of time
};

}  // namespace facet::animate
