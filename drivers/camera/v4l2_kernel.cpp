#include "camera/v4l2_kernel.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <ctime>

#include "facet/clock.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

class SystemKernel final : public V4l2Kernel {
 public:
  int open(const std::string& path) override {
    return repeat([&] { return ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC); });
  }
  void close(int fd) override { ::close(fd); }
  int ioctl(int fd, unsigned long request, void* argument) override {
    return repeat([&] { return ::ioctl(fd, request, argument); });
  }
  void* map(int fd, std::size_t length, std::int64_t offset) override {
    void* start = ::mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, fd, offset);
    return start == MAP_FAILED ? nullptr : start;
  }
  void unmap(void* start, std::size_t length) override { ::munmap(start, length); }
  int wait(int fd, std::int64_t until_ns) override {
    pollfd descriptor{fd, POLLIN, 0};
    const int ready = repeat([&] {
      const std::int64_t left_ns = std::max<std::int64_t>(0, until_ns - monotonic_ns());
      const timespec left{left_ns / kSecond_ns, left_ns % kSecond_ns};
      return ::ppoll(&descriptor, 1, &left, nullptr);
    });
    return ready <= 0 ? ready : descriptor.revents;
  }
  std::int64_t monotonic_ns() override { return Clock::now_ns(); }
  std::int64_t realtime_ns() override { return Clock::utc().time_since_epoch().count(); }

 private:
  template <typename Call>
  static int repeat(Call call) {
    for (;;) {
      const int result = call();
      if (result >= 0) {
        return result;
      }
      if (errno != EINTR) {
        return -errno;
      }
    }
  }
};

}  // namespace

V4l2Kernel& system_v4l2_kernel() {
  static SystemKernel kernel;
  return kernel;
}

}  // namespace facet::camera
