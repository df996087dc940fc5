#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace facet::gpu {

/// What makes an access: the parts of a device that a barrier tells apart.
enum class By : std::uint8_t {
  Kernel,
  Copy,      ///< and fill
  Indirect,  ///< the number of workgroups read for a dispatch
};
constexpr std::size_t by_count = 3;

/// One step's use of a part of a resource.
struct Access {
  std::uint64_t resource = 0;  ///< handle of the buffer or image
  std::size_t begin = 0;       ///< first byte, or first level
  std::size_t end = 0;         ///< one behind the last
  bool writes = false;
  By by = By::Kernel;
};

/// Whether the order of two uses matters: of the same part, at least one of them writing. Within one dispatch
/// none may: compilers take its resources as apart, and may move a read by one name behind a write by
/// another.
inline bool conflict(const Access& a, const Access& b) {
  return a.resource == b.resource && a.begin < b.end && b.begin < a.end && (a.writes || b.writes);
}

/// A barrier: what must be done, and who waits for it. Sets of By, bit by bit; none where nobody waits.
struct Wait {
  std::uint32_t before = 0;
  std::uint32_t after = 0;

  static constexpr std::uint32_t bit(By by) { return 1U << static_cast<std::uint32_t>(by); }
};

/// Knows what the steps recorded so far read and wrote, and so which barrier the next one needs: where it
/// touches what was written, or writes what was read, by then without a barrier that those who touch it now
/// waited at.
class HazardTracker {
 public:
  Wait wait_for(std::span<const Access> step) const {
    Wait wait;
    for (const Access& next : step) {
      for (const Access& earlier : not_waited_for(next.by)) {
        if (conflict(earlier, next)) {
          wait.after |= Wait::bit(next.by);
          break;
        }
      }
    }
    for (const By by : {By::Kernel, By::Copy, By::Indirect}) {
      if ((wait.after & Wait::bit(by)) != 0) {
        for (const Access& earlier : not_waited_for(by)) {
          wait.before |= Wait::bit(earlier.by);
        }
      }
    }
    return wait;
  }
  void add(std::span<const Access> step) {
    for (std::vector<Access>& all : not_waited_for_) {
      all.insert(all.end(), step.begin(), step.end());
    }
  }
  /// There is a barrier now: whoever is in wait.after has waited for all that was added.
  void waited(const Wait& wait) {
    for (const By by : {By::Kernel, By::Copy, By::Indirect}) {
      if ((wait.after & Wait::bit(by)) != 0) {
        not_waited_for_[static_cast<std::size_t>(by)].clear();
      }
    }
  }

 private:
  const std::vector<Access>& not_waited_for(By by) const {
    return not_waited_for_[static_cast<std::size_t>(by)];
  }

  std::array<std::vector<Access>, by_count> not_waited_for_;  ///< by who would have to wait
};

}  // namespace facet::gpu
