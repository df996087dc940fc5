#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "animate/face_ik.hpp"
#include "animate/take_basis.hpp"
#include "mesh/hierarchy.hpp"
#include "simulation/actor_take.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::test {

/// A small actor: 1,089 control vertices.
inline const face::FaceModel& actor_model() {
  static const face::FaceModel model = synthetic_model();
  return model;
}

inline simulation::ActorTake small_actor(std::uint64_t seed, int frames) {
  return {actor_model(), {seed, frames, 30, 9'000}};
}

using FrameMaker = std::function<std::shared_ptr<const mesh::MeshFrame>(int)>;

/// Records frames 0 to frames - 1 as they are made.
inline void record_frames(const std::filesystem::path& file, int frames, const FrameMaker& make) {
  take::TakeRecorderConfig config;
  config.file = file;
  config.source = "virtual actor";
  config.software = "facet tests";
  config.when_full = take::WhenFull::Wait;
  config.disk_reserve_bytes = 0;
  take::TakeRecorder recorder(config);
  recorder.start();
  for (int index = 0; index < frames; ++index) {
    recorder.record(make(index));
  }
  recorder.stop();
}

/// A take of the actor's performance.
inline std::filesystem::path record_actor(const std::filesystem::path& folder, std::uint64_t seed,
                                          int frames) {
  const simulation::ActorTake actor = small_actor(seed, frames);
  const std::filesystem::path file = folder / ("actor" + std::to_string(seed) + ".take");
  record_frames(file, frames, [&](int index) { return actor.frame(index); });
  return file;
}

inline mesh::Vertices finest_of(const mesh::MeshFrame& frame) {
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*frame.subject->hierarchy, frame.control_vertices_mm, frame.displacements_mm, vertices,
                       normals);
  return vertices;
}

/// The mesh that a pose makes, rebuilt as any consumer would.
inline mesh::Vertices finest_of(const animate::TakeBasis& basis, const animate::Pose& pose) {
  mesh::MeshFrame frame = animate::blank_frame(basis);
  animate::blend(basis, pose, frame);
  return finest_of(frame);
}

inline mesh::Vertices captured(const animate::TakeBasis& basis, std::size_t face) {
  take::TakeReader reader(basis.take());
  return finest_of(*reader.frame(basis.frames()[face].index));
}

/// `count` vertices of the face's front, at least 12 mm apart.
inline std::vector<std::int32_t> scattered_vertices(const animate::TakeBasis& basis, std::size_t count,
                                                    std::mt19937& random) {
  std::vector<std::int32_t> chosen;
  while (chosen.size() < count) {
    const auto vertex =
        static_cast<std::int32_t>(random() % static_cast<std::uint32_t>(basis.finest_count()));
    const Eigen::Vector3f at = basis.rest_mm().col(vertex);
    const bool apart = std::all_of(chosen.begin(), chosen.end(), [&](std::int32_t other) {
      return (basis.rest_mm().col(other) - at).norm() > 12;
    });
    // Where the model's expressions move something: mouth, chin, lids, brows.
    const bool moves = at.y() < -45 && at.y() > -95 && std::abs(at.x()) < 40;
    if (apart && (moves || (at.y() > 18 && at.y() < 38 && std::abs(at.x()) < 20))) {
      chosen.push_back(vertex);
    }
  }
  return chosen;
}

}  // namespace facet::test
