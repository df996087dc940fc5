#include "trigger/real_time.hpp"

#include <fmt/format.h>
#include <linux/capability.h>
#include <malloc.h>
#include <pthread.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>

namespace facet::trigger {
namespace {

/// Less than a picture or a message with one; more than what is allocated with every frame.
constexpr int kOwnMapping_bytes = 256 * 1024;

bool has_ipc_lock() {
  __user_cap_header_struct header = {_LINUX_CAPABILITY_VERSION_3, 0};
  std::array<__user_cap_data_struct, _LINUX_CAPABILITY_U32S_3> data = {};
  return ::syscall(SYS_capget, &header, data.data()) == 0 &&
         (data[CAP_TO_INDEX(CAP_IPC_LOCK)].effective & CAP_TO_MASK(CAP_IPC_LOCK)) != 0;
}

/// Empty where memory is locked, else what is missing.
std::string lock_memory() {
  rlimit limit = {};
  ::getrlimit(RLIMIT_MEMLOCK, &limit);
  if (limit.rlim_cur != RLIM_INFINITY && !has_ipc_lock()) {
    return fmt::format("memory is not locked: only {} KiB may be (LimitMEMLOCK=infinity allows it)",
                       limit.rlim_cur / 1024);
  }
  // What is freed within glibc's heaps goes back by MADV_DONTNEED, which locked memory refuses: whatever once
  // was in use at the same time would stay. Blocks with a mapping of their own are unmapped; they are those
  // from this size on, which else grows to that of the largest one freed.
  ::mallopt(M_MMAP_THRESHOLD, kOwnMapping_bytes);
  if (::mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0) {
    return fmt::format("memory is not locked: {}", std::strerror(errno));
  }
  return "";
}

}  // namespace

RealTime become_real_time(int priority) {
  const sched_param parameters = {.sched_priority = priority};
  const int error = ::pthread_setschedparam(::pthread_self(), SCHED_FIFO, &parameters);
  const std::string scheduled =
      error == 0 ? fmt::format("SCHED_FIFO {}", priority)
                 : fmt::format("no real-time priority: {} (LimitRTPRIO={} or CAP_SYS_NICE allows it)",
                               std::strerror(error), priority);
  const std::string locked = lock_memory();
  return {error == 0 && locked.empty(), scheduled + "; " + (locked.empty() ? "memory is locked" : locked)};
}

}  // namespace facet::trigger
