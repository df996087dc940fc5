#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "face/face_model.hpp"
#include "mesh/mesh_frame.hpp"
#include "simulation/performance.hpp"
#include "simulation/wrinkles.hpp"

namespace facet::simulation {

struct ActorTakeConfig {
  std::uint64_t seed = 1;
  int frame_count = 300;
  int rate_hz = 30;
  std::int32_t max_vertices = 40'000;  ///< of the finest level
};

/// A take of a virtual actor as a tracker without error would make it: an identity inside the model's span
/// that performs (Performance) and wrinkles (Wrinkles), as meshes of the face model's topology in front of a
/// camera; no pictures. Everything follows from the seed. Any thread once built.
class ActorTake {
 public:
  /// Throws Error(UnreadableInput) where the model has no landmark map.
  ActorTake(const face::FaceModel& model, const ActorTakeConfig& config);

  int frame_count() const { return config_.frame_count; }
  /// Frame `index` of the performance, of state Tracking.
  std::shared_ptr<const mesh::MeshFrame> frame(int index) const;
  /// Any expression [expression_count] 0 to 1, held by a head that is still.
  mesh::MeshFrame shape(std::span<const float> expression) const;

  const mesh::Subject& subject() const { return *subject_; }

 private:
  ActorTakeConfig config_;
  Performance performance_;
  face::ExpressionBasis basis_;
  std::shared_ptr<const mesh::Subject> subject_;
  std::shared_ptr<const mesh::Albedo> albedo_;
  std::optional<Wrinkles> wrinkles_;
};

}  // namespace facet::simulation
