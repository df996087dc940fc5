#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace facet::gpu {

/// One step's use of a part of a resource.
struct Access {
  std::uint64_t resource = 0;  ///< handle of the buffer or image
  std::size_t begin = 0;       ///< first byte, or first level
  std::size_t end = 0;         ///< one behind the last
  bool writes = false;
};

/// Whether the order of two uses matters: of the same part, at least one of them writing. Within one dispatch
/// none may: compilers take its resources as apart, and may move a read by one name behind a write by
/// another.
inline bool conflict(const Access& a, const Access& b) {
  return a.resource == b.resource && a.begin < b.end && b.begin < a.end && (a.writes || b.writes);
}

/// Knows what the steps since the last barrier read and wrote, and so whether the next one needs a barrier:
/// where it touches what was written, or writes what was read.
class HazardTracker {
 public:
  bool conflicts(std::span<const Access> step) const {
    for (const Access& next : step) {
      for (const Access& earlier : since_barrier_) {
        if (conflict(earlier, next)) {
          return true;
        }
      }
    }
    return false;
  }
  void add(std::span<const Access> step) {
    since_barrier_.insert(since_barrier_.end(), step.begin(), step.end());
  }
  void clear() { since_barrier_.clear(); }

 private:
  std::vector<Access> since_barrier_;
};

}  // namespace facet::gpu
