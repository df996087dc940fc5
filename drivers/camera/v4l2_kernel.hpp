#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace facet::camera {

/// What the V4L2 driver asks of the kernel, as thin as it goes; tests script one. Calls return what the
/// system call returns, or minus its errno. Interrupted calls are repeated.
class V4l2Kernel {
 public:
  V4l2Kernel() = default;
  V4l2Kernel(const V4l2Kernel&) = delete;
  V4l2Kernel& operator=(const V4l2Kernel&) = delete;
  virtual ~V4l2Kernel() = default;

  /// For reading and writing, not blocking; a descriptor.
  virtual int open(const std::string& path) = 0;
  virtual void close(int fd) = 0;
  virtual int ioctl(int fd, unsigned long request, void* argument) = 0;
  /// Null where it fails.
  virtual void* map(int fd, std::size_t length, std::int64_t offset) = 0;
  virtual void unmap(void* start, std::size_t length) = 0;
  /// Waits until there is a filled buffer or an error (the events of poll), or 0 once it is `until_ns`
  /// (CLOCK_MONOTONIC). fd -1: waits for the time alone.
  virtual int wait(int fd, std::int64_t until_ns) = 0;
  virtual std::int64_t monotonic_ns() = 0;
  virtual std::int64_t realtime_ns() = 0;
};

/// The kernel of this machine.
V4l2Kernel& system_v4l2_kernel();

}  // namespace facet::camera
