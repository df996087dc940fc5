#include "system_calls.hpp"

#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <mutex>
#include <system_error>
#include <utility>

namespace {

std::mutex hooks_mutex;
std::function<void(const std::string&)> before_sync;  // guarded by the mutex
std::function<bool(const std::string&)> may_sync;     // likewise

/// A file that got its name after it was opened is called deleted for ever by /proc: what it is called now.
std::string path_of(int fd) {
  std::error_code none;
  const std::filesystem::path path =
      std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(fd), none);
  struct stat wanted {};
  struct stat found {};
  if (path.string().ends_with(" (deleted)") && ::fstat(fd, &wanted) == 0) {
    for (const auto& entry : std::filesystem::directory_iterator(path.parent_path(), none)) {
      if (::stat(entry.path().c_str(), &found) == 0 && found.st_ino == wanted.st_ino) {
        return entry.path();
      }
    }
  }
  return path;
}

int sync_file(long call, int fd) {
  std::function<void(const std::string&)> hook;
  std::function<bool(const std::string&)> decide;
  {
    const std::lock_guard lock(hooks_mutex);
    hook = before_sync;
    decide = may_sync;
  }
  if (hook || decide) {
    const std::string path = path_of(fd);
    if (hook) {
      hook(path);
    }
    if (decide && !decide(path)) {
      errno = EIO;
      return -1;
    }
  }
  return static_cast<int>(::syscall(call, fd));
}

}  // namespace

extern "C" int fdatasync(int fd) {
  return sync_file(SYS_fdatasync, fd);
}
extern "C" int fsync(int fd) {
  return sync_file(SYS_fsync, fd);
}

namespace facet::test {

void hook_syncs(std::function<void(const std::string&)> hook) {
  const std::lock_guard lock(hooks_mutex);
  before_sync = std::move(hook);
}

void decide_syncs(std::function<bool(const std::string&)> decide) {
  const std::lock_guard lock(hooks_mutex);
  may_sync = std::move(decide);
}

}  // namespace facet::test
