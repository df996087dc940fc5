#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "face/face_model.hpp"
#include "person/keyframes.hpp"
#include "person/shape_solver.hpp"

namespace facet::person {

/// Finds the same skin in all keyframes: each picture is unwrapped into the model's texture chart with the
/// head as it is held to be, and the flow between that and the mean of all tells how far off it is
/// (docs/person.md, "The same skin in every picture"). One thread.
class SkinFlow {
 public:
  /// chart_texels: of the chart's longer side. model must outlive it.
  SkinFlow(const face::FaceModel& model, int chart_texels);
  ~SkinFlow();

  /// keyframes  with pictures
  /// solver     the head in each of them, its shape and the camera
  /// order      keyframes as they join the mean, the most frontal one first; empty: the solver has them well
  /// enough
  ///            for the mean to be that of all as they are
  /// joins      [keyframe] 0: it is compared with the mean and no part of it
  /// between    called twice or three times for each keyframe; may throw
  /// returns    [keyframe]
  std::vector<SkinPoints> find(const std::vector<Keyframe>& keyframes, const ShapeSolver& solver,
                               const Eigen::Vector2d& centre_px, const std::vector<std::size_t>& order,
                               const std::vector<char>& joins, const std::function<void()>& between);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::person
