#include "refine/observation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "refine_shaders.hpp"

namespace facet::refine {
namespace {

// The finest mesh has no use for more pixels, and an 8K pyramid would not fit into the memory that Facet may
// take.
constexpr int kLargestSidePx = 2048;
// Mips and interpolation read beyond the face's outline by at most the width of the coarsest mip used.
constexpr int kRegionMarginPx = 48;
constexpr std::uint32_t kTriangleGroup = 64;
constexpr float kNearMm = 10;

int reduction_for(int width_px, int height_px) {
  return std::max(1, (std::max(width_px, height_px) + kLargestSidePx - 1) / kLargestSidePx);
}

int reduced(int size_px, int reduction) {
  return (size_px + reduction - 1) / reduction;
}

/// Of the linear image: whole tiles.
std::uint32_t padded(int size_px, int reduction) {
  const int tile = shaders::refine::kImageTilePx;
  return static_cast<std::uint32_t>((reduced(size_px, reduction) + tile - 1) / tile * tile);
}

/// The picture is uploaded as it is, and reduced on the device.
std::size_t uploaded_pixels(gpu::Context& context, int width_px, int height_px) {
  const auto pixels = static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  const gpu::DeviceInfo& info = context.info();
  const std::size_t most = std::min(info.max_storage_buffer_bytes / 4, info.max_texel_buffer_elements);
  if (pixels > most) {
    throw Error(ErrorKind::NoDevice,
                fmt::format("a picture of {}x{} px is more than '{}' can take ({} pixels)", width_px,
                            height_px, info.name, most));
  }
  return pixels;
}

}  // namespace

ImagePyramid::ImagePyramid(gpu::Context& context, int source_width_px, int source_height_px)
    : width_px(source_width_px),
      height_px(source_height_px),
      reduction(reduction_for(source_width_px, source_height_px)),
      pixels(context, uploaded_pixels(context, source_width_px, source_height_px), gpu::TexelFormat::Rgba8,
             "pixels", gpu::Memory::Upload),
      linear(context, gpu::ImageFormat::Rgba16f, padded(source_width_px, reduction),
             padded(source_height_px, reduction), shaders::refine::kImageMips, "linear image") {}

void ImagePyramid::write(const Frame& frame, const Eigen::Array2i& low_px,
                         const Eigen::Array2i& high_px) const {
  if ((high_px <= low_px).any()) {
    return;
  }
  const auto pixel_bytes = gpu::texel_bytes(gpu::TexelFormat::Rgba8);
  const std::size_t row_bytes = pixel_bytes * static_cast<std::size_t>(width_px);
  const std::size_t first_bytes = pixel_bytes * static_cast<std::size_t>(low_px.x());
  const std::size_t part_bytes = pixel_bytes * static_cast<std::size_t>(high_px.x() - low_px.x());
  std::byte* target = pixels.buffer.mapped().data() + first_bytes;
  for (int row = low_px.y(); row < high_px.y(); ++row) {
    std::memcpy(target + static_cast<std::size_t>(row) * row_bytes, frame.row(row) + first_bytes, part_bytes);
  }
}

void upload_picture(ImagePyramid& pyramid, const FaceRegion& region, const Frame& picture,
                    shaders::refine::FrameParameters& out) {
  if (picture.empty()) {
    out.source_px.z = 0;
    out.region_px = {0, 0, 0, 0};
    return;
  }
  if (!pyramid.filled) {
    out.region_px = {0, 0, static_cast<std::int32_t>(pyramid.linear.width_px()),
                     static_cast<std::int32_t>(pyramid.linear.height_px())};
    pyramid.write(picture);
    pyramid.filled = true;
    return;
  }
  const Eigen::Array2i source_px(pyramid.width_px, pyramid.height_px);
  // The edge of the picture goes on where the linear image is larger: its last row and column are read there.
  pyramid.write(picture, (region.low_px * pyramid.reduction).min(source_px - 1),
                (region.high_px * pyramid.reduction).min(source_px));
}

void to_shading_frame(const mesh::Vertices& head_vertices_mm, std::span<const float> displacements_mm,
                      const Eigen::Isometry3f& camera_from_head, std::span<shaders::vec4> out) {
  const Eigen::Matrix3f rotation = camera_from_head.linear();
  const Eigen::Vector3f translation = camera_from_head.translation();
  for (Eigen::Index i = 0; i < head_vertices_mm.cols(); ++i) {
    const Eigen::Vector3f p = rotation * head_vertices_mm.col(i) + translation;
    const auto vertex = static_cast<std::size_t>(i);
    out[vertex] = {p.x(), -p.y(), -p.z(), displacements_mm.empty() ? 0.0F : displacements_mm[vertex]};
  }
}

FaceRegion set_frame_parameters(const ImagePyramid& pyramid, const CameraIntrinsics& camera,
                                std::span<const shaders::vec4> vertices,
                                shaders::refine::FrameParameters& out,
                                const Eigen::Isometry3f& view_from_reference) {
  const auto k = static_cast<float>(pyramid.reduction);
  const int width = reduced(pyramid.width_px, pyramid.reduction);
  const int height = reduced(pyramid.height_px, pyramid.reduction);
  const Eigen::Array2i padded_px(static_cast<int>(pyramid.linear.width_px()),
                                 static_cast<int>(pyramid.linear.height_px()));
  out.projection = {camera.fx / k, camera.fy / k, (camera.cx + 0.5F) / k - 0.5F,
                    (camera.cy + 0.5F) / k - 0.5F};
  out.image_size = {static_cast<float>(width), static_cast<float>(height),
                    1 / static_cast<float>(padded_px.x()), 1 / static_cast<float>(padded_px.y())};
  out.reduction = pyramid.reduction;
  out.source_px = {pyramid.width_px, pyramid.height_px, 1, 0};
  const Eigen::Vector3f half_turn(1, -1, -1);  // camera axes to those of shading and back
  Eigen::Matrix4f view = view_from_reference.matrix();
  view.topRows<3>() = half_turn.asDiagonal() * view.topRows<3>();
  view.leftCols<3>() = view.leftCols<3>() * half_turn.asDiagonal();
  for (Eigen::Index column = 0; column < 4; ++column) {
    out.view_from_reference.columns[column] = {view(0, column), view(1, column), view(2, column),
                                               view(3, column)};
  }

  Eigen::Array2f low(static_cast<float>(width), static_cast<float>(height));
  Eigen::Array2f high(0, 0);
  for (const shaders::vec4& vertex : vertices) {
    const Eigen::Vector4f p = view * Eigen::Vector4f(vertex.x, vertex.y, vertex.z, 1);
    if (-p.z() > kNearMm) {
      const Eigen::Array2f px(out.projection.x * p.x() / -p.z() + out.projection.z,
                              out.projection.y * -p.y() / -p.z() + out.projection.w);
      low = low.min(px);
      high = high.max(px);
    }
  }
  const Eigen::Array2f last(static_cast<float>(width), static_cast<float>(height));
  low = low.max(0).min(last);
  high = high.min(last).max(low + 1);
  const float depth_scale =
      static_cast<float>(OcclusionMap::size_px - 2) / std::max(high.x() - low.x(), high.y() - low.y());
  out.depth_from_px = {depth_scale, depth_scale, 1 - depth_scale * low.x(), 1 - depth_scale * low.y()};

  FaceRegion region;
  constexpr int block = shaders::refine::kImageBlockPx;
  region.low_px = (low.cast<int>() - kRegionMarginPx).max(0) / block * block;
  region.high_px = ((high.cast<int>() + kRegionMarginPx + block - 1) / block * block).min(padded_px);
  out.region_px = {region.low_px.x(), region.low_px.y(), region.high_px.x(), region.high_px.y()};
  return region;
}

OcclusionMap::OcclusionMap(gpu::Context& context, const mesh::Triangles& corners)
    : triangle_count(static_cast<std::uint32_t>(corners.cols())),
      workgroup_count(
          std::min(context.info().workgroup_count, gpu::groups_for(triangle_count, kTriangleGroup))),
      triangles(context, triangle_count, gpu::TexelFormat::Rgba32i, "triangles"),
      depth_bits(context, sizeof(std::uint32_t) * size_px * size_px, gpu::Memory::Device, "depth map") {
  std::vector<std::array<std::int32_t, 4>> packed(triangle_count);
  for (std::size_t t = 0; t < packed.size(); ++t) {
    const auto triangle = corners.col(static_cast<Eigen::Index>(t));
    packed[t] = {triangle[0], triangle[1], triangle[2], 0};
  }
  gpu::upload(context, triangles.buffer, std::as_bytes(std::span(packed)));
}

FurtherCameraState::FurtherCameraState(gpu::Context& context, int width_px, int height_px,
                                       const mesh::Triangles& triangles)
    : pyramid(context, width_px, height_px),
      frame(context, sizeof(shaders::refine::FrameParameters), gpu::Memory::Upload, "frame parameters"),
      depth(context, triangles),
      sums(context, 2 * sizeof(shaders::vec4) * context.info().workgroup_count, gpu::Memory::Device,
           "view sums"),
      gain(context, sizeof(shaders::refine::ViewGain), gpu::Memory::Device, "view gain") {
  frame.mapped_as<shaders::refine::FrameParameters>().front() = {};
  clear(context, {&gain});
}

ObservationKernels::ObservationKernels(gpu::Context& context)
    : linear_image_(context, shaders::refine::kernels(), "refine/linear_image"),
      small_mips_(context, shaders::refine::kernels(), "refine/small_mips"),
      rasterise_depth_(context, shaders::refine::kernels(), "refine/rasterise_depth"),
      prolong_(context, shaders::refine::kernels(), "refine/prolong"),
      prolong_values_(context, shaders::refine::kernels(), "refine/prolong_values"),
      observe_(context, shaders::refine::kernels(), "refine/observe"),
      view_sums_(context, shaders::refine::kernels(), "refine/view_sums"),
      view_gain_(context, shaders::refine::kernels(), "refine/view_gain"),
      merge_view_(context, shaders::refine::kernels(), "refine/merge_view"),
      sampler_(context, gpu::Filter::Linear, gpu::Filter::Linear) {}

void ObservationKernels::record_image(gpu::Batch& batch, const ImagePyramid& pyramid,
                                      const gpu::Buffer& frame) const {
  const auto [blocks_x, blocks_y, depth] = linear_image_.workgroup_size();
  const std::uint32_t block = shaders::refine::kImageBlockPx;
  batch.dispatch(linear_image_,
                 {{"frame", frame},
                  {"pixels", pyramid.pixels.view},
                  {"linear_image", pyramid.linear, 0},
                  {"half_image", pyramid.linear, 1},
                  {"quarter_image", pyramid.linear, 2}},
                 {gpu::groups_for(pyramid.linear.width_px(), block * blocks_x),
                  gpu::groups_for(pyramid.linear.height_px(), block * blocks_y)});
}

void ObservationKernels::record_mips(gpu::Batch& batch, const ImagePyramid& pyramid,
                                     const gpu::Buffer& frame) const {
  const auto [tiles_x, tiles_y, depth] = small_mips_.workgroup_size();
  const std::uint32_t tile = shaders::refine::kImageTilePx;
  batch.dispatch(small_mips_,
                 {{"frame", frame},
                  {"quarter_image", pyramid.linear, sampler_, 2},
                  {"eighth_image", pyramid.linear, 3},
                  {"sixteenth_image", pyramid.linear, 4},
                  {"smallest_image", pyramid.linear, 5}},
                 {gpu::groups_for(pyramid.linear.width_px(), tile * tiles_x),
                  gpu::groups_for(pyramid.linear.height_px(), tile * tiles_y)});
}

void ObservationKernels::record_prolong(gpu::Batch& batch, const LevelTopology& topology,
                                        const LevelStencils& stencils, const gpu::TexelView& coarser,
                                        const LevelState& state, const gpu::Buffer& frame,
                                        const LevelStart& start) const {
  const shaders::refine::LevelPush push{topology.vertex_count, start.prior == Prior::None ? 0.0F : 1.0F,
                                        start.refine ? 1.0F : 0.0F, start.prior == Prior::Given ? 1.0F : 0.0F,
                                        start.bound_mm};
  batch.dispatch(prolong_,
                 {{"frame", frame},
                  {"vertex_rings", topology.vertex_rings.view},
                  {"stencil_rows", stencils.stencil_rows.view},
                  {"stencil_entries", stencils.stencil_entries.view},
                  {"coarser", coarser},
                  {"reliefs", state.reliefs.view},
                  {"positions", state.positions.buffer},
                  {"priors", state.priors.buffer}},
                 {topology.workgroup_count}, push);
}

void ObservationKernels::record_prolong_values(gpu::Batch& batch, const LevelTopology& topology,
                                               const LevelStencils& stencils, const DeviceArray& coarser,
                                               const DeviceArray& values) const {
  const shaders::refine::LevelPush push{topology.vertex_count, 0, 0, 0, 0};
  batch.dispatch(prolong_values_,
                 {{"stencil_rows", stencils.stencil_rows.view},
                  {"stencil_entries", stencils.stencil_entries.view},
                  {"coarser", coarser.view},
                  {"values", values.buffer}},
                 {topology.workgroup_count}, push);
}

void ObservationKernels::record_depth(gpu::Batch& batch, const LevelState& coarsest, const OcclusionMap& map,
                                      const gpu::Buffer& frame) const {
  constexpr std::uint32_t kInfinityBits = 0x7f800000;
  batch.fill(map.depth_bits, kInfinityBits);
  const shaders::refine::DepthPush push{map.triangle_count, OcclusionMap::size_px};
  batch.dispatch(rasterise_depth_,
                 {{"frame", frame},
                  {"positions", coarsest.positions.view},
                  {"triangles", map.triangles.view},
                  {"depth_bits", map.depth_bits}},
                 {map.workgroup_count}, push);
}

void ObservationKernels::record_observe(gpu::Batch& batch, const LevelTopology& topology,
                                        const LevelState& state, const gpu::Buffer& colours,
                                        const ImagePyramid& pyramid, const OcclusionMap& map,
                                        const gpu::Buffer& frame) const {
  const shaders::refine::ObservePush push{topology.vertex_count, OcclusionMap::size_px};
  batch.dispatch(observe_,
                 {{"frame", frame},
                  {"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"positions", state.positions.view},
                  {"linear_image", pyramid.linear, sampler_},
                  {"depth_bits", map.depth_bits},
                  {"normals", state.normals.buffer},
                  {"colours", colours}},
                 {topology.workgroup_count}, push);
}

void ObservationKernels::record_view(gpu::Batch& batch, const LevelTopology& topology,
                                     const LevelState& state, const FurtherCameraState& view,
                                     const DeviceArray& view_colours, bool learn_gain, bool last) const {
  record_observe(batch, topology, state, view_colours.buffer, view.pyramid, view.depth, view.frame);
  const shaders::refine::ViewPush push{topology.vertex_count, last ? 1U : 0U, topology.workgroup_count};
  if (learn_gain) {
    batch.dispatch(
        view_sums_,
        {{"colours", state.colours.view}, {"view_colours", view_colours.view}, {"view_sums", view.sums}},
        {topology.workgroup_count}, push);
    batch.dispatch(view_gain_, {{"view_sums", view.sums}, {"view_gain", view.gain}}, {}, push);
  }
  batch.dispatch(
      merge_view_,
      {{"view_colours", view_colours.view}, {"view_gain", view.gain}, {"colours", state.colours.buffer}},
      {topology.workgroup_count}, push);
}

}  // namespace facet::refine
