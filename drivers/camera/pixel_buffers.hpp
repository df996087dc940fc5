#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

namespace facet::camera {

/// Rows of delivered pictures begin at multiples of this: what vector code likes.
inline constexpr int kRowAlignment_bytes = 64;

constexpr int rgba_stride_bytes(int width_px) {
  return (width_px * 4 + kRowAlignment_bytes - 1) / kRowAlignment_bytes * kRowAlignment_bytes;
}

/// Pixel buffers that come back when their last reader lets go of them; it outlives the camera while readers
/// hold frames.
class PixelBuffers : public std::enable_shared_from_this<PixelBuffers> {
 public:
  /// Any thread. Costs one small control block a frame once as many buffers exist as are in use at a time.
  std::shared_ptr<std::uint8_t[]> take(std::size_t size_bytes) {
    Buffer buffer;
    {
      const std::scoped_lock lock(mutex_);
      if (!free_.empty()) {
        buffer = std::move(free_.back());
        free_.pop_back();
      }
    }
    if (buffer == nullptr) {
      buffer.reset(
          static_cast<std::uint8_t*>(::operator new[](size_bytes, std::align_val_t{kRowAlignment_bytes})));
    }
    return {buffer.release(), [pool = shared_from_this()](std::uint8_t* bytes) { pool->give_back(bytes); }};
  }

 private:
  struct Free {
    void operator()(std::uint8_t* bytes) const {
      ::operator delete[](bytes, std::align_val_t{kRowAlignment_bytes});
    }
  };
  using Buffer = std::unique_ptr<std::uint8_t[], Free>;

  void give_back(std::uint8_t* bytes) {
    const std::scoped_lock lock(mutex_);
    free_.emplace_back(bytes);
  }

  std::mutex mutex_;
  std::vector<Buffer> free_;  // every buffer of one camera has one size
};

}  // namespace facet::camera
