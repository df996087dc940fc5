#include "gpu/downsample.hpp"

#include "gpu_shaders.hpp"

namespace facet::gpu {

Downsampler::Downsampler(Context& context)
    : kernel_(context, shaders::gpu::kernels(), "gpu/downsample"), sampler_(context, Filter::Nearest) {}

void Downsampler::record(Batch& batch, const Image& image, std::uint32_t first_level) const {
  if (image.format() != ImageFormat::Rgba16f) {
    throw Error(ErrorKind::Internal, "only images of Rgba16f are made smaller: the kernel names its format");
  }
  const auto [tile_x_px, tile_y_px, depth] = kernel_.workgroup_size();
  for (std::uint32_t level = first_level; level < image.level_count(); ++level) {
    batch.dispatch(
        kernel_, {{"source", image, sampler_, level - 1}, {"target", image, level}},
        {groups_for(image.width_px(level), tile_x_px), groups_for(image.height_px(level), tile_y_px)});
  }
}

}  // namespace facet::gpu
