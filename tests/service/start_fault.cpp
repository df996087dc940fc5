// A library to be loaded before a program (LD_PRELOAD), for tests.
// FACET_FAIL: what fails once; "start_fault: done" is then written to standard error.
//   CALL N ERRNO [PART]   the N-th call of CALL (open, read, thread) gives ERRNO;
//                         of open and read those alone whose file has PART in its path
// FACET_STALL: what a disk does not do; each call that begins to wait writes "start_fault: waits".
//   CALL GATE PART        each CALL (read, sync) of a file with PART in its path waits
//                         as long as the file GATE exists

#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <sys/uio.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

namespace {

struct Order {
  std::array<char, 16> call{};
  long number = 0;
  int error = 0;
  std::array<char, 128> part{};

  Order() {
    const char* text = std::getenv("FACET_FAIL");
    if (text != nullptr &&
        std::sscanf(text, "%15s %ld %d %127s", call.data(), &number, &error, part.data()) < 3) {
      std::abort();
    }
  }
};

void say(const char* text) {
  [[maybe_unused]] const ssize_t ignored = ::write(STDERR_FILENO, text, std::strlen(text));
}

/// Waits where this call is one that does.
void stall(const char* call, const char* path) {
  struct Gate {
    std::array<char, 16> call{};
    std::array<char, 256> file{};
    std::array<char, 128> part{};

    Gate() {
      const char* text = std::getenv("FACET_STALL");
      if (text != nullptr &&
          std::sscanf(text, "%15s %255s %127s", call.data(), file.data(), part.data()) != 3) {
        std::abort();
      }
    }
    bool stands() const { return ::access(file.data(), F_OK) == 0; }
  };
  static const Gate gate;
  constexpr useconds_t kLookUs = 2000;
  if (std::strcmp(gate.call.data(), call) != 0 || std::strstr(path, gate.part.data()) == nullptr ||
      !gate.stands()) {
    return;
  }
  say("start_fault: waits\n");
  while (gate.stands()) {
    ::usleep(kLookUs);
  }
}

/// Whether this call is the one; sets errno.
bool fails(const char* call, const char* path) {
  static const Order order;
  static std::atomic<long> calls{0};
  if (std::strcmp(order.call.data(), call) != 0 || std::strstr(path, order.part.data()) == nullptr ||
      ++calls != order.number) {
    return false;
  }
  say("start_fault: done\n");
  errno = order.error;
  return true;
}

template <typename Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(::dlsym(RTLD_NEXT, name));
}

int open_next(const char* name, const char* path, int flags, mode_t mode) {
  return fails("open", path) ? -1 : next<int (*)(const char*, int, ...)>(name)(path, flags, mode);
}

int openat_next(const char* name, int folder, const char* path, int flags, mode_t mode) {
  return fails("open", path) ? -1
                             : next<int (*)(int, const char*, int, ...)>(name)(folder, path, flags, mode);
}

FILE* fopen_next(const char* name, const char* path, const char* mode) {
  return fails("open", path) ? nullptr : next<FILE* (*)(const char*, const char*)>(name)(path, mode);
}

std::string path_of(int descriptor) {
  std::array<char, 512> path{};
  const std::string link = "/proc/self/fd/" + std::to_string(descriptor);
  const ssize_t size = ::readlink(link.c_str(), path.data(), path.size() - 1);
  return size > 0 ? path.data() : "";
}

bool read_fails(int descriptor) {
  const std::string path = path_of(descriptor);
  stall("read", path.c_str());
  return fails("read", path.c_str());
}

}  // namespace

extern "C" {

int open(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const auto mode = static_cast<mode_t>((flags & O_CREAT) != 0 ? va_arg(rest, int) : 0);
  va_end(rest);
  return open_next("open", path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const auto mode = static_cast<mode_t>((flags & O_CREAT) != 0 ? va_arg(rest, int) : 0);
  va_end(rest);
  return open_next("open64", path, flags, mode);
}

int openat(int folder, const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const auto mode = static_cast<mode_t>((flags & O_CREAT) != 0 ? va_arg(rest, int) : 0);
  va_end(rest);
  return openat_next("openat", folder, path, flags, mode);
}

int openat64(int folder, const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const auto mode = static_cast<mode_t>((flags & O_CREAT) != 0 ? va_arg(rest, int) : 0);
  va_end(rest);
  return openat_next("openat64", folder, path, flags, mode);
}

FILE* fopen(const char* path, const char* mode) {
  return fopen_next("fopen", path, mode);
}

FILE* fopen64(const char* path, const char* mode) {
  return fopen_next("fopen64", path, mode);
}

ssize_t read(int descriptor, void* out, size_t size) {
  return read_fails(descriptor) ? -1 : next<ssize_t (*)(int, void*, size_t)>("read")(descriptor, out, size);
}

ssize_t readv(int descriptor, const iovec* out, int count) {
  return read_fails(descriptor) ? -1
                                : next<ssize_t (*)(int, const iovec*, int)>("readv")(descriptor, out, count);
}

ssize_t pread(int descriptor, void* out, size_t size, off_t at) {
  return read_fails(descriptor)
             ? -1
             : next<ssize_t (*)(int, void*, size_t, off_t)>("pread")(descriptor, out, size, at);
}

int fsync(int descriptor) {
  stall("sync", path_of(descriptor).c_str());
  return next<int (*)(int)>("fsync")(descriptor);
}

int fdatasync(int descriptor) {
  stall("sync", path_of(descriptor).c_str());
  return next<int (*)(int)>("fdatasync")(descriptor);
}

int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*run)(void*), void* argument) {
  if (fails("thread", "")) {
    return errno;
  }
  return next<int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*)>("pthread_create")(
      thread, attributes, run, argument);
}

}  // extern "C"
