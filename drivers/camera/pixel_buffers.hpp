#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "facet/mutex.hpp"

namespace facet::camera {

/// Rows of delivered pictures begin at multiples of this: what vector code likes.
inline constexpr int kRowAlignment_bytes = 64;

constexpr int rgba_stride_bytes(int width_px) {
  return (width_px * 4 + kRowAlignment_bytes - 1) / kRowAlignment_bytes * kRowAlignment_bytes;
}

/// Pixel buffers that come back when their last reader lets go of them; it outlives the camera while readers
/// hold frames. kKept buffers are made, and touched, with the first one; where readers hold more at a time,
/// further ones are made and freed again, so that what a burst took is given back.
class PixelBuffers : public std::enable_shared_from_this<PixelBuffers> {
 public:
  /// What frame sets, queues and readers hold of a camera in normal times.
  static constexpr std::size_t kKept = 8;

  /// Any thread; all buffers of one camera have one size. Costs one small control block a frame while no more
  /// than kKept buffers are in use.
  std::shared_ptr<std::uint8_t[]> take(std::size_t size_bytes) {
    Buffer buffer;
    {
      const Lock lock(mutex_);
      while (made_ < kKept) {
        free_.push_back(make(size_bytes));
        std::memset(free_.back().get(), 0, size_bytes);
        ++made_;
      }
      if (!free_.empty()) {
        buffer = std::move(free_.back());
        free_.pop_back();
      }
    }
    if (buffer == nullptr) {
      buffer = make(size_bytes);
      const Lock lock(mutex_);
      ++made_;
    }
    return {buffer.release(), [pool = shared_from_this()](std::uint8_t* bytes) { pool->give_back(bytes); }};
  }

  /// Buffers that there are, in use or not.
  std::size_t count() const {
    const Lock lock(mutex_);
    return made_;
  }

 private:
  struct Free {
    void operator()(std::uint8_t* bytes) const {
      ::operator delete[](bytes, std::align_val_t{kRowAlignment_bytes});
    }
  };
  using Buffer = std::unique_ptr<std::uint8_t[], Free>;

  static Buffer make(std::size_t size_bytes) {
    return Buffer(
        static_cast<std::uint8_t*>(::operator new[](size_bytes, std::align_val_t{kRowAlignment_bytes})));
  }

  void give_back(std::uint8_t* bytes) {
    Buffer buffer(bytes);
    const Lock lock(mutex_);
    if (made_ <= kKept) {
      free_.push_back(std::move(buffer));
    } else {
      --made_;
    }
  }

  mutable Mutex mutex_;
  std::vector<Buffer> free_ FACET_GUARDED_BY(mutex_);
  std::size_t made_ FACET_GUARDED_BY(mutex_) = 0;
};

}  // namespace facet::camera
