#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>

#include "gpu/context.hpp"

namespace facet::gpu {

enum class ImageFormat { Rgba8, Rgba16f, Rgba32f, R32f };

/// Bytes of one pixel.
std::size_t pixel_bytes(ImageFormat format);

/// A two-dimensional image with a mip chain, usable as sampled image, storage image and in copies alike.
/// Level n is max(1, width >> n) by max(1, height >> n) pixels. Contents are undefined until written.
class Image {
 public:
  /// level_count  1 for no mips, 0 for all down to 1x1; more than there are is an error
  Image(Context& context, ImageFormat format, std::uint32_t width_px, std::uint32_t height_px,
        std::uint32_t level_count, std::string_view name);
  ~Image();
  Image(Image&&) noexcept;
  Image& operator=(Image&&) noexcept;

  ImageFormat format() const;
  std::uint32_t level_count() const;
  std::uint32_t width_px(std::uint32_t level = 0) const;
  std::uint32_t height_px(std::uint32_t level = 0) const;
  /// Bytes of one level, rows packed without gaps: what copies to and from buffers use.
  std::size_t level_bytes(std::uint32_t level) const;

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

enum class Filter { Nearest, Linear };

/// How `sampler2D` reads: clamped at the edge, normalised coordinates, within one level by `filter` and
/// between levels (`textureLod` with a fraction) by `between_levels`.
class Sampler {
 public:
  explicit Sampler(Context& context, Filter filter = Filter::Linear, Filter between_levels = Filter::Nearest);
  ~Sampler();
  Sampler(Sampler&&) noexcept;
  Sampler& operator=(Sampler&&) noexcept;

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::gpu
