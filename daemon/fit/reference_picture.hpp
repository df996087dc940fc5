#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "fit/projected_light.hpp"
#include "mesh/mesh.hpp"

namespace facet::fit {

/// What one camera saw of the skin in a good moment, drawn again where the mesh is now. The flow from that
/// to the camera's picture tells how far every vertex has drifted from its skin; flow from picture to picture
/// alone adds up its errors (past the paper, whose template drifts). One thread at a time.
class ReferencePicture {
 public:
  /// picture      of the camera, kept
  /// vertices_mm  [3][vertex_count] the mesh at that moment, rig frame
  /// normals      [3][vertex_count] of it
  /// visible      [vertex_count] what the camera saw of it (find_visible)
  /// light        of the projectors, its shadows cast by that mesh. How much of the picture it lit, and how
  ///              much the room did, is read off the picture; where that is all, nothing is relit.
  ReferencePicture(const capture::Lens& lens, Frame picture, const mesh::Vertices& vertices_mm,
                   const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles,
                   const std::vector<std::uint8_t>& visible, const ProjectedLight& light);
  ~ReferencePicture();
  ReferencePicture(ReferencePicture&& other) noexcept;

  /// `now` with the skin drawn over it where the mesh is, from the reference and in the light of now.
  /// now      the camera's picture, of the reference's size: what is around the skin, and how bright it is
  /// normals  [3][vertex_count] of the mesh now
  /// visible  [vertex_count] what the camera sees of it
  /// light    as the mesh casts its shadows now
  /// drawn    [height][width] out: 1 where skin was drawn
  Frame draw(const Frame& now, const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
             const std::vector<std::uint8_t>& visible, const ProjectedLight& light,
             std::vector<std::uint8_t>& drawn) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::fit
