#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <span>

#include "facet/frame.hpp"
#include "mesh/mesh.hpp"
#include "refine/level_buffers.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {

/// Room on the device for images of one size, and their linear pyramid.
struct ImagePyramid {
  /// Throws Error(NoDevice) where the device has no room for the source's picture, or can't bind it.
  ImagePyramid(gpu::Context& context, int source_width_px, int source_height_px);

  /// Copies a part of a frame of that size, [low_px, high_px), to the upload buffer. Real-time safe.
  void write(const Frame& frame, const Eigen::Array2i& low_px, const Eigen::Array2i& high_px) const;
  void write(const Frame& frame) const { write(frame, {0, 0}, {width_px, height_px}); }

  int width_px;  ///< of the source
  int height_px;
  int reduction;        ///< source pixels to one of the linear image, per axis
  DeviceArray pixels;   ///< [height][width] 8-bit sRGB as uploaded
  gpu::Image linear;    ///< linear RGB and 1 where unsaturated, with mips; padded to whole tiles
  bool filled = false;  ///< has held a whole picture
};

/// Where a frame's face lies and how it projects.
struct FaceRegion {
  Eigen::Array2i low_px;   ///< of the linear image
  Eigen::Array2i high_px;  ///< past the end
};

/// Fills projection, region, depth map mapping and the camera's place for the coarse mesh as it stands in
/// this frame; the other members of `out` stay. vertices: the reference camera's shading frame, mm.
/// view_from_reference: camera frames. Real-time safe.
FaceRegion set_frame_parameters(const ImagePyramid& pyramid, const CameraIntrinsics& camera,
                                std::span<const shaders::vec4> vertices,
                                shaders::refine::FrameParameters& out,
                                const Eigen::Isometry3f& view_from_reference = Eigen::Isometry3f::Identity());

/// Uploads what a frame needs of a camera's picture: the face's region, of the first picture all, for the
/// region's surroundings must hold some colour before the mips are read. Without a picture the camera says
/// nothing of the frame. out: as set_frame_parameters filled it. Real-time safe.
void upload_picture(ImagePyramid& pyramid, const FaceRegion& region, const Frame& picture,
                    shaders::refine::FrameParameters& out);

/// The vertices in the shading frame (camera frame turned by half a turn about x), fourth their
/// displacements; where none are given, 0. Real-time safe.
void to_shading_frame(const mesh::Vertices& head_vertices_mm, std::span<const float> displacements_mm,
                      const Eigen::Isometry3f& camera_from_head, std::span<shaders::vec4> out);

/// The coarse mesh's depth map, over the face's region.
struct OcclusionMap {
  /// triangles: of M0
  OcclusionMap(gpu::Context& context, const mesh::Triangles& triangles);

  /// Side, px: two pixels to an edge of a mesh of 5 K vertices that fills the region.
  static constexpr std::uint32_t size_px = 256;

  std::uint32_t triangle_count;
  std::uint32_t workgroup_count;
  DeviceArray triangles;
  gpu::Buffer depth_bits;  ///< [size_px][size_px] z as float bits, infinity where there is no face
};

/// A camera beside the reference camera: its picture, where it stands, and how its colours differ.
struct FurtherCameraState {
  /// triangles: of M0
  FurtherCameraState(gpu::Context& context, int width_px, int height_px, const mesh::Triangles& triangles);

  ImagePyramid pyramid;
  gpu::Buffer frame;  ///< FrameParameters: those that record_image, record_depth and record_observe read
  OcclusionMap depth;
  gpu::Buffer sums;  ///< [workgroup][2] vec4, for the gain
  gpu::Buffer gain;  ///< ViewGain
};

/// What a level's displacements are drawn towards.
enum class Prior {
  None,       ///< nothing: displacements begin at 0
  Prolonged,  ///< those that shading gave the coarser level
  Given,      ///< those that came with the control vertices; what shading does not move stands there
};

/// How a level begins.
struct LevelStart {
  bool refine = false;  ///< shading moves this level
  Prior prior = Prior::None;
  float bound_mm = 1e9F;  ///< displacements begin within +- this
};

/// What the cameras see of every vertex: linear image pyramid, depth map of the coarse mesh, positions,
/// coarse normals and sampled colours of every level.
class ObservationKernels {
 public:
  explicit ObservationKernels(gpu::Context& context);

  /// Records sRGB to linear light and the mips down to a quarter.
  void record_image(gpu::Batch& batch, const ImagePyramid& pyramid, const gpu::Buffer& frame) const;

  /// Records the mips below.
  void record_mips(gpu::Batch& batch, const ImagePyramid& pyramid, const gpu::Buffer& frame) const;

  /// Records positions, start displacements and priors of a level from the next coarser one. coarser: a view
  /// of positions and displacements.
  void record_prolong(gpu::Batch& batch, const LevelTopology& topology, const LevelStencils& stencils,
                      const gpu::TexelView& coarser, const LevelState& state, const gpu::Buffer& frame,
                      const LevelStart& start) const;

  /// Records four numbers a vertex of a level (albedo, irradiance) from the next coarser one's.
  void record_prolong_values(gpu::Batch& batch, const LevelTopology& topology, const LevelStencils& stencils,
                             const DeviceArray& coarser, const DeviceArray& values) const;

  /// Records the depth map from the positions of M0.
  void record_depth(gpu::Batch& batch, const LevelState& coarsest, const OcclusionMap& map,
                    const gpu::Buffer& frame) const;

  /// Records coarse normals, spacings and colours of a level as one camera sees it.
  void record_observe(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                      const ImagePyramid& pyramid, const OcclusionMap& map, const gpu::Buffer& frame) const {
    record_observe(batch, topology, state, state.colours.buffer, pyramid, map, frame);
  }

  /// Records what a further camera sees of a level and its mean with what the cameras before it see there.
  /// view_colours: room for the level's vertices. learn_gain: on M0, before the finer levels. last: there is
  /// no further camera.
  void record_view(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                   const FurtherCameraState& view, const DeviceArray& view_colours, bool learn_gain,
                   bool last) const;

 private:
  void record_observe(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                      const gpu::Buffer& colours, const ImagePyramid& pyramid, const OcclusionMap& map,
                      const gpu::Buffer& frame) const;

  gpu::Kernel linear_image_;
  gpu::Kernel small_mips_;
  gpu::Kernel rasterise_depth_;
  gpu::Kernel prolong_;
  gpu::Kernel prolong_values_;
  gpu::Kernel observe_;
  gpu::Kernel view_sums_;
  gpu::Kernel view_gain_;
  gpu::Kernel merge_view_;
  gpu::Sampler sampler_;
};

}  // namespace facet::refine
