#include "camera/host_sandbox.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/landlock.h>
#include <linux/netlink.h>
#include <seccomp.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <system_error>

namespace facet::camera {
namespace {

[[noreturn]] void fail(const std::string& what, int error) {
  throw std::runtime_error(fmt::format("its process can't be confined: {}: {}", what, std::strerror(error)));
}

// ---- files: Landlock

// Debian 12's headers (Linux 6.1) and C library know the first three versions, and no functions for them.

/// struct landlock_ruleset_attr as of version 6. Older kernels take it as long as what they don't know is 0.
struct Ruleset {
  std::uint64_t files;
  std::uint64_t network;
  std::uint64_t scopes;
};

constexpr std::uint64_t kRefer = 1U << 13U;         // version 2
constexpr std::uint64_t kTruncate = 1U << 14U;      // version 3
constexpr std::uint64_t kDeviceIoctl = 1U << 15U;   // version 5
constexpr std::uint64_t kTcp = 0b11;                // version 4: bind, connect
constexpr std::uint64_t kSocketsAndSignals = 0b11;  // version 6: abstract sockets and signals to outside

constexpr std::uint64_t kReadFile = LANDLOCK_ACCESS_FS_READ_FILE;
constexpr std::uint64_t kRead = kReadFile | LANDLOCK_ACCESS_FS_READ_DIR;

/// All rights over files that a version knows.
std::uint64_t file_rights(int version) {
  std::uint64_t rights = kRefer - 1;
  rights |= version >= 2 ? kRefer : 0;
  rights |= version >= 3 ? kTruncate : 0;
  rights |= version >= 5 ? kDeviceIoctl : 0;
  return rights;
}

/// The kernel's version of Landlock; minus an errno where it has none.
int landlock_version() {
  const long version =
      ::syscall(SYS_landlock_create_ruleset, nullptr, std::size_t{0}, LANDLOCK_CREATE_RULESET_VERSION);
  return version >= 0 ? static_cast<int>(version) : -errno;
}

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) {
      ::close(fd_);
    }
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

void allow_path(int ruleset, const std::filesystem::path& path, std::uint64_t rights) {
  const Descriptor at(::open(path.c_str(), O_PATH | O_CLOEXEC));
  if (at.get() < 0) {
    return;  // what can't be reached needs no right
  }
  struct stat status {};
  if (::fstat(at.get(), &status) != 0) {
    fail(path.string(), errno);
  }
  landlock_path_beneath_attr rule{};
  // A right that only folders have is refused for a file.
  rule.allowed_access =
      S_ISDIR(status.st_mode) ? rights : rights & ~std::uint64_t{LANDLOCK_ACCESS_FS_READ_DIR};
  rule.parent_fd = at.get();
  if (::syscall(SYS_landlock_add_rule, ruleset, LANDLOCK_RULE_PATH_BENEATH, &rule, 0U) != 0) {
    fail(path.string(), errno);
  }
}

void confine_files(const HostReach& reach) {
  const int version = landlock_version();
  if (version < 0) {
    return;
  }
  const Ruleset rules{file_rights(version), version >= 4 ? kTcp : 0, version >= 6 ? kSocketsAndSignals : 0};
  const Descriptor ruleset(
      static_cast<int>(::syscall(SYS_landlock_create_ruleset, &rules, sizeof rules, 0U)));
  if (ruleset.get() < 0) {
    fail("Landlock", errno);
  }
  for (const char* path : {"/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/sys", "/run/udev", "/proc/self"}) {
    allow_path(ruleset.get(), path, kRead);
  }
  for (const std::filesystem::path& path : reach.readable) {
    allow_path(ruleset.get(), path, kRead);
  }
  const std::uint64_t device = kRead | LANDLOCK_ACCESS_FS_WRITE_FILE | kDeviceIoctl;
  allow_path(ruleset.get(), "/dev/null", device & rules.files);
  for (const std::filesystem::path& path : reach.devices) {
    allow_path(ruleset.get(), path, device & rules.files);
  }
  if (::syscall(SYS_landlock_restrict_self, ruleset.get(), 0U) != 0) {
    fail("Landlock", errno);
  }
}

// ---- system calls: seccomp

/// What a library that drives cameras, the C and C++ libraries and the sanitizers' do. What is not here is
/// answered with ENOSYS, upon which libraries take an older way; so is clone3, whose flags no filter can see.
constexpr std::array kCalls = {
    // memory
    SCMP_SYS(brk), SCMP_SYS(madvise), SCMP_SYS(membarrier), SCMP_SYS(memfd_create), SCMP_SYS(mincore),
    SCMP_SYS(mlock), SCMP_SYS(mmap), SCMP_SYS(mprotect), SCMP_SYS(mremap), SCMP_SYS(munlock),
    SCMP_SYS(munmap),
    // what is open
    SCMP_SYS(close), SCMP_SYS(close_range), SCMP_SYS(dup), SCMP_SYS(dup2), SCMP_SYS(dup3),
    SCMP_SYS(fallocate), SCMP_SYS(flock), SCMP_SYS(fstat), SCMP_SYS(fstatfs), SCMP_SYS(ftruncate),
    SCMP_SYS(lseek), SCMP_SYS(pipe), SCMP_SYS(pipe2), SCMP_SYS(pread64), SCMP_SYS(preadv), SCMP_SYS(pwrite64),
    SCMP_SYS(read), SCMP_SYS(readv), SCMP_SYS(write), SCMP_SYS(writev),
    // names of files; opening them: see below
    SCMP_SYS(access), SCMP_SYS(faccessat), SCMP_SYS(faccessat2), SCMP_SYS(getcwd), SCMP_SYS(getdents),
    SCMP_SYS(getdents64), SCMP_SYS(lstat), SCMP_SYS(newfstatat), SCMP_SYS(readlink), SCMP_SYS(readlinkat),
    SCMP_SYS(stat), SCMP_SYS(statfs), SCMP_SYS(statx),
    // waiting
    SCMP_SYS(epoll_create), SCMP_SYS(epoll_create1), SCMP_SYS(epoll_ctl), SCMP_SYS(epoll_pwait),
    SCMP_SYS(epoll_pwait2), SCMP_SYS(epoll_wait), SCMP_SYS(eventfd2), SCMP_SYS(poll), SCMP_SYS(ppoll),
    SCMP_SYS(pselect6), SCMP_SYS(select), SCMP_SYS(timerfd_create), SCMP_SYS(timerfd_gettime),
    SCMP_SYS(timerfd_settime),
    // the sockets that it has; making one: see below
    SCMP_SYS(bind), SCMP_SYS(getpeername), SCMP_SYS(getsockname), SCMP_SYS(getsockopt), SCMP_SYS(recvfrom),
    SCMP_SYS(recvmsg), SCMP_SYS(sendmsg), SCMP_SYS(sendto), SCMP_SYS(setsockopt), SCMP_SYS(shutdown),
    // threads
    SCMP_SYS(exit), SCMP_SYS(exit_group), SCMP_SYS(futex), SCMP_SYS(gettid), SCMP_SYS(rseq),
    SCMP_SYS(sched_getaffinity), SCMP_SYS(sched_getparam), SCMP_SYS(sched_getscheduler),
    SCMP_SYS(sched_yield), SCMP_SYS(set_robust_list), SCMP_SYS(set_tid_address),
    // signals to itself
    SCMP_SYS(pause), SCMP_SYS(restart_syscall), SCMP_SYS(rt_sigaction), SCMP_SYS(rt_sigprocmask),
    SCMP_SYS(rt_sigreturn), SCMP_SYS(rt_sigsuspend), SCMP_SYS(rt_sigtimedwait), SCMP_SYS(sigaltstack),
    // time and itself
    SCMP_SYS(clock_getres), SCMP_SYS(clock_gettime), SCMP_SYS(clock_nanosleep), SCMP_SYS(getcpu),
    SCMP_SYS(getegid), SCMP_SYS(geteuid), SCMP_SYS(getgid), SCMP_SYS(getpgrp), SCMP_SYS(getpid),
    SCMP_SYS(getppid), SCMP_SYS(getrandom), SCMP_SYS(getrlimit), SCMP_SYS(getrusage), SCMP_SYS(gettimeofday),
    SCMP_SYS(getuid), SCMP_SYS(nanosleep), SCMP_SYS(sysinfo), SCMP_SYS(time), SCMP_SYS(uname)};

/// Not F_SETOWN and F_SETSIG, which have the kernel send signals to anybody.
constexpr std::array kDescriptorCommands = {
    F_DUPFD,  F_GETFD,     F_SETFD,     F_GETFL,      F_SETFL,     F_GETLK,     F_SETLK,
    F_SETLKW, F_OFD_GETLK, F_OFD_SETLK, F_OFD_SETLKW, F_ADD_SEALS, F_GET_SEALS, F_DUPFD_CLOEXEC};

/// The letters of V4L2, media controllers, DMA heaps, DMA buffers, udmabuf; and T's, of which none but those
/// that ask: one writes into a terminal as if it were its keyboard (TIOCSTI).
constexpr std::array kIoctlLetters = {'V', '|', 'H', 'b', 'u'};
constexpr std::array<std::uint64_t, 3> kTerminalIoctls = {0x5401 /*TCGETS*/, 0x541B /*FIONREAD*/,
                                                          0x5421 /*FIONBIO*/};

constexpr std::array kProcessSettings = {PR_SET_NAME, PR_GET_NAME, PR_GET_DUMPABLE, PR_CAPBSET_READ,
                                         0x53564d41 /*PR_SET_VMA: names of memory*/};

class Filter {
 public:
  Filter() : filter_(::seccomp_init(SCMP_ACT_ERRNO(ENOSYS)), &::seccomp_release) {
    if (filter_ == nullptr) {
      fail("seccomp", ENOMEM);
    }
  }

  template <typename... Conditions>
  void allow(int call, Conditions... conditions) {
    check(::seccomp_rule_add(filter_.get(), SCMP_ACT_ALLOW, call, sizeof...(conditions), conditions...));
  }

  void load() { check(::seccomp_load(filter_.get())); }

 private:
  static void check(int result) {
    if (result < 0) {
      fail("seccomp", -result);
    }
  }

  std::unique_ptr<void, decltype(&::seccomp_release)> filter_;
};

/// Of a register's 64 bits the kernel takes 32 as `int`: what is above is the caller's leftover.
scmp_arg_cmp equals_int(unsigned argument, std::uint64_t value) {
  return {argument, SCMP_CMP_MASKED_EQ, 0xffff'ffff, value};
}
scmp_arg_cmp has_bits(unsigned argument, std::uint64_t mask, std::uint64_t bits) {
  return {argument, SCMP_CMP_MASKED_EQ, mask, bits};
}

void confine_calls() {
  Filter filter;
  for (const int call : kCalls) {
    filter.allow(call);
  }
  // Nothing is made or emptied by opening. (O_TMPFILE holds O_DIRECTORY's bit, which alone is harmless.)
  constexpr std::uint64_t kMaking = O_CREAT | O_TRUNC | (O_TMPFILE & ~O_DIRECTORY);
  filter.allow(SCMP_SYS(open), has_bits(1, kMaking, 0));
  filter.allow(SCMP_SYS(openat), has_bits(2, kMaking, 0));
  filter.allow(SCMP_SYS(socket), equals_int(0, AF_NETLINK), equals_int(2, NETLINK_KOBJECT_UEVENT));
  filter.allow(SCMP_SYS(clone), has_bits(0, CLONE_THREAD, CLONE_THREAD));
  filter.allow(SCMP_SYS(tgkill), equals_int(0, static_cast<std::uint32_t>(::getpid())));
  filter.allow(SCMP_SYS(prlimit64), equals_int(0, 0));
  for (const int command : kDescriptorCommands) {
    filter.allow(SCMP_SYS(fcntl), equals_int(1, static_cast<std::uint64_t>(command)));
  }
  for (const int option : kProcessSettings) {
    filter.allow(SCMP_SYS(prctl), equals_int(0, static_cast<std::uint64_t>(option)));
  }
  for (const char letter : kIoctlLetters) {
    filter.allow(SCMP_SYS(ioctl), has_bits(1, 0xff00, static_cast<std::uint64_t>(letter) << 8U));
  }
  for (const std::uint64_t request : kTerminalIoctls) {
    filter.allow(SCMP_SYS(ioctl), equals_int(1, request));
  }
  filter.load();
}

}  // namespace

std::string files_unguarded() {
  const int version = landlock_version();
  switch (version < 0 ? -version : 0) {
    case 0:
      return "";
    case EOPNOTSUPP:
      return "Landlock is switched off in this kernel (lsm= of its command line)";
    case ENOSYS:
      return "this kernel has no Landlock (Linux 5.13 or newer)";
    default:
      return fmt::format("Landlock can't be used: {}", std::strerror(-version));
  }
}

void confine_host(const HostReach& reach) {
  if (::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) {
    fail("no new privileges", errno);
  }
  confine_files(reach);
  confine_calls();
}

}  // namespace facet::camera
