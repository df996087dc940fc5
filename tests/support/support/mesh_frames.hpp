#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "mesh/mesh_frame.hpp"

namespace facet::test {

/// A bent patch of quads, `side` by `side` control vertices, 150 mm wide, refined adaptively as a face is.
inline std::shared_ptr<const mesh::Hierarchy> patch_hierarchy(int side = 9, int max_levels = 3) {
  mesh::ControlMesh control;
  control.vertex_count = side * side;
  control.refinable.assign(static_cast<std::size_t>(control.vertex_count), 1);
  control.texture_coordinates.resize(2, control.vertex_count);
  control.quads.resize(4, Eigen::Index{side - 1} * (side - 1));
  mesh::TextureCoordinates control_px(2, control.vertex_count);
  for (int row = 0; row < side; ++row) {
    for (int column = 0; column < side; ++column) {
      const int vertex = row * side + column;
      const auto u = static_cast<float>(column) / static_cast<float>(side - 1);
      const auto v = static_cast<float>(row) / static_cast<float>(side - 1);
      control.texture_coordinates.col(vertex) << u, v;
      control_px.col(vertex) << 600.0F * u, 600.0F * v;
      if (row + 1 < side && column + 1 < side) {
        control.quads.col(row * (side - 1) + column) << vertex, vertex + 1, vertex + side + 1, vertex + side;
      }
    }
  }
  mesh::HierarchyOptions options;
  options.max_levels = max_levels;
  const std::vector<std::uint8_t> facing(static_cast<std::size_t>(control.vertex_count), 1);
  return mesh::build_hierarchy(control, control_px, facing, options);
}

inline std::shared_ptr<const mesh::Subject> patch_subject(std::uint64_t id = 0xF00DF00DF00DF00DULL,
                                                          int side = 9, int max_levels = 3) {
  auto subject = std::make_shared<mesh::Subject>();
  subject->id = id;
  subject->hierarchy = patch_hierarchy(side, max_levels);
  subject->expression_names = {"jawOpen", "eyeBlinkLeft", "mouthSmileRight"};
  subject->identity = {0.5F, -1.25F, 2.0F, 0.0F};
  subject->regions.assign(static_cast<std::size_t>(subject->hierarchy->control_vertex_count), 1);
  return subject;
}

inline std::shared_ptr<const mesh::Albedo> patch_albedo(const mesh::Subject& subject,
                                                        std::uint64_t version = 1) {
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = version;
  const auto count = static_cast<std::size_t>(subject.hierarchy->finest().vertex_count);
  for (std::size_t i = 0; i < 3 * count; ++i) {
    albedo->linear_rgb.push_back(0.25F + 0.5F * static_cast<float>(i % 97) / 97.0F);
  }
  return albedo;
}

/// A frame of state Tracking with everything in it, different for every sequence number. The pose puts the
/// patch 600 mm in front of the camera, upright.
inline mesh::MeshFrame patch_frame(std::uint64_t sequence, std::shared_ptr<const mesh::Subject> subject,
                                   std::shared_ptr<const mesh::Albedo> albedo) {
  std::mt19937 random(static_cast<std::uint32_t>(sequence) + 17U);
  const auto uniform = [&random](float low, float high) {
    return low + (high - low) * static_cast<float>(random() >> 8U) / 16777216.0F;
  };
  const mesh::Hierarchy& hierarchy = *subject->hierarchy;
  mesh::MeshFrame frame;
  frame.sequence = sequence;
  frame.timestamp_ns = 1'000'000'000 + static_cast<std::int64_t>(sequence) * 33'333'333;
  frame.media_time_ns = static_cast<std::int64_t>(sequence) * 33'333'333;
  frame.state = mesh::TrackingState::Tracking;
  frame.camera = {1100.0F, 1100.0F, 639.5F, 359.5F, 1280, 720};
  frame.camera_from_head = Eigen::AngleAxisf(uniform(-0.3F, 0.3F), Eigen::Vector3f::UnitY()) *
                           Eigen::AngleAxisf(3.14159265F, Eigen::Vector3f::UnitX());
  frame.camera_from_head.pretranslate(Eigen::Vector3f(uniform(-20, 20), uniform(-20, 20), 600.0F));
  for (std::size_t i = 0; i < subject->expression_names.size(); ++i) {
    frame.expression.push_back(uniform(0, 1));
  }
  for (int i = 0; i < 468; ++i) {
    frame.landmarks_px.emplace_back(uniform(300, 900), uniform(100, 600));
  }
  frame.reprojection_px = uniform(0.5F, 2);
  frame.control_vertices_mm.resize(3, hierarchy.control_vertex_count);
  const int side = static_cast<int>(std::lround(std::sqrt(hierarchy.control_vertex_count)));
  for (int vertex = 0; vertex < hierarchy.control_vertex_count; ++vertex) {
    const float x = 150.0F * (static_cast<float>(vertex % side) / static_cast<float>(side - 1) - 0.5F);
    const int row = vertex / side;
    const float y = 150.0F * (static_cast<float>(row) / static_cast<float>(side - 1) - 0.5F);
    frame.control_vertices_mm.col(vertex) << x, y, 60.0F - 0.008F * (x * x + y * y) + uniform(-0.2F, 0.2F);
  }
  for (int i = 0; i < hierarchy.finest().vertex_count; ++i) {
    frame.displacements_mm.push_back(uniform(-1.5F, 1.5F));
    frame.confidence.push_back(uniform(0, 1));
  }
  for (float& coefficient : frame.lighting) {
    coefficient = uniform(-0.5F, 1);
  }
  frame.photometric_rms = uniform(0.01F, 0.05F);
  frame.stage_ms.landmarks_ms = 3.5F;
  frame.stage_ms.displacement_ms = uniform(10, 20);
  frame.stage_ms.latency_ms = 42.0F;
  frame.subject = std::move(subject);
  frame.albedo = std::move(albedo);
  return frame;
}

/// A frame in which no face is known.
inline mesh::MeshFrame searching_frame(std::uint64_t sequence) {
  mesh::MeshFrame frame;
  frame.sequence = sequence;
  frame.timestamp_ns = 1'000'000'000 + static_cast<std::int64_t>(sequence) * 33'333'333;
  frame.media_time_ns = static_cast<std::int64_t>(sequence) * 33'333'333;
  frame.camera = {1100.0F, 1100.0F, 639.5F, 359.5F, 1280, 720};
  return frame;
}

}  // namespace facet::test
