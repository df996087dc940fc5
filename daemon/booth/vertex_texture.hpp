#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::booth {

/// The skin's colour under the booth's even light, as the colour cameras see it in blank slots: per vertex,
/// blended by how squarely a camera looks at it, and averaged over the slots. One thread.
class VertexTexture {
 public:
  /// A new person.
  void begin(Eigen::Index vertex_count);

  /// What one camera sees of a mesh. vertices_mm, normals [3][vertex_count] rig frame. An empty or damaged
  /// frame adds nothing.
  void add(const capture::Lens& lens, const Frame& frame, const mesh::Vertices& vertices_mm,
           const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles);

  /// After every slot: makes a new Albedo after slots 1, 2, 4 ... 64, then stays with the last.
  void publish();

  /// Null before the first. Vertices that no camera has seen have the mean colour of those seen.
  const std::shared_ptr<const mesh::Albedo>& latest() const { return latest_; }

 private:
  std::vector<Eigen::Vector4f> sums_;  ///< [vertex_count] weighted linear RGB, weight
  std::uint64_t slots_ = 0;
  std::uint64_t version_ = 0;  ///< never the same again, whoever is seen
  std::vector<std::uint8_t> visible_;
  std::shared_ptr<const mesh::Albedo> latest_;
};

}  // namespace facet::booth
