#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <type_traits>

#include "gpu/context.hpp"

namespace facet::gpu {

enum class Memory {
  Device,  ///< fastest for kernels; the host cannot see it
  Upload,  ///< mapped for good, the host writes and the device reads: per-frame parameters, staging. The host
           ///< must not read it: it may be uncached, or behind a bus (DeviceInfo::uploads_to_device)
  Readback,  ///< mapped for good, the device writes and the host reads
};

/// Device memory of a fixed size, usable as storage, uniform, texel, indirect and copy buffer alike.
/// Its contents are undefined until written. Movable; destroying it while a submitted batch uses it is an
/// error.
class Buffer {
 public:
  /// size_bytes  > 0 and at most DeviceInfo::max_storage_buffer_bytes
  /// name        for messages of the validation layers
  /// Throws Error(NoDevice) where the device has no such memory left.
  Buffer(Context& context, std::size_t size_bytes, Memory memory, std::string_view name);
  ~Buffer();
  Buffer(Buffer&&) noexcept;
  Buffer& operator=(Buffer&&) noexcept;

  std::size_t size_bytes() const;

  /// The whole buffer as the host sees it, [size_bytes]; empty for Memory::Device. Coherent: what the host
  /// writes before submit the batch sees, what the batch wrote the host sees after wait. Real-time safe.
  std::span<std::byte> mapped() const;

  /// The same as values of T, [size_bytes / sizeof(T)].
  template <typename T>
  std::span<T> mapped_as() const {
    static_assert(std::is_trivially_copyable_v<T>);
    const std::span<std::byte> bytes = mapped();
    // Vulkan maps at 64-byte boundaries at least, so any scalar or vector type is aligned.
    return {reinterpret_cast<T*>(bytes.data()), bytes.size() / sizeof(T)};
  }

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

enum class TexelFormat { Rgba32f, Rg32f, R32f, Rgba16f, Rg16f, R16f, R32i, R32u, Rg32i, Rgba32i, Rgba8 };

/// Bytes of one element.
std::size_t texel_bytes(TexelFormat format);

/// A typed view of a buffer: in a kernel `samplerBuffer`, `isamplerBuffer`, `usamplerBuffer` to read, and
/// `imageBuffer`, `iimageBuffer`, `uimageBuffer` where one dispatch reads what it wrote. On lavapipe the fast
/// way to read (3 to 6 times a storage buffer). The buffer must outlive it.
class TexelView {
 public:
  /// offset_bytes   a multiple of DeviceInfo::buffer_alignment_bytes
  /// element_count  0: to the end of the buffer
  TexelView(const Buffer& buffer, TexelFormat format, std::size_t offset_bytes = 0,
            std::size_t element_count = 0);
  ~TexelView();
  TexelView(TexelView&&) noexcept;
  TexelView& operator=(TexelView&&) noexcept;

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

/// Writes bytes into a buffer of any kind and waits. For set-up, not for the per-frame path. Throws
/// DeviceLostError.
void upload(Context& context, const Buffer& target, std::span<const std::byte> bytes,
            std::size_t offset_bytes = 0);
/// Reads bytes from a buffer of any kind and waits. For set-up and tests. Throws DeviceLostError.
void download(Context& context, const Buffer& source, std::span<std::byte> bytes,
              std::size_t offset_bytes = 0);

template <typename T>
void upload(Context& context, const Buffer& target, std::span<const T> values, std::size_t offset_bytes = 0) {
  static_assert(std::is_trivially_copyable_v<T>);
  upload(context, target, std::as_bytes(values), offset_bytes);
}
template <typename T>
void download(Context& context, const Buffer& source, std::span<T> values, std::size_t offset_bytes = 0) {
  static_assert(std::is_trivially_copyable_v<T>);
  download(context, source, std::as_writable_bytes(values), offset_bytes);
}

}  // namespace facet::gpu
