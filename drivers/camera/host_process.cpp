#include "camera/host_process.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <system_error>

#include "facet/clock.hpp"
#include "facet/mutex.hpp"

namespace facet::camera {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
/// A killed process is gone within this, unless a driver holds it in the kernel.
constexpr int kKillPatience_ms = 1000;

[[noreturn]] void fail(const std::string& what) {
  throw DeviceFault(DeviceFault::Kind::Failing, what);
}

[[noreturn]] void fail(const std::string& what, int error) {
  fail(fmt::format("{}: {}", what, std::strerror(error)));
}

/// Processes that were killed and did not end in time.
class Stragglers {
 public:
  void add(pid_t pid) {
    const Lock lock(mutex_);
    pids_.push_back(pid);
  }
  void bury() {
    const Lock lock(mutex_);
    const auto gone = [](pid_t pid) { return ::waitpid(pid, nullptr, WNOHANG) != 0; };
    pids_.erase(std::remove_if(pids_.begin(), pids_.end(), gone), pids_.end());
  }

 private:
  Mutex mutex_;
  std::vector<pid_t> pids_ FACET_GUARDED_BY(mutex_);
};

Stragglers& stragglers() {
  static Stragglers them;
  return them;
}

/// What a process begins with: descriptors 3 and 4 and the standard ones, no signal blocked or ignored, a
/// group of its own.
class SpawnSettings {
 public:
  SpawnSettings(int socket, int memory) {
    ::posix_spawn_file_actions_init(&actions_);
    ::posix_spawnattr_init(&attributes_);
    // Where a descriptor is one of the wanted numbers already, dup2 leaves it closed on exec: copies stand
    // aside first.
    constexpr int kAside = 100;
    ::posix_spawn_file_actions_adddup2(&actions_, socket, kAside);
    if (memory >= 0) {
      ::posix_spawn_file_actions_adddup2(&actions_, memory, kAside + 1);
    }
    ::posix_spawn_file_actions_addopen(&actions_, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // A library's chatter is no output of ours.
    ::posix_spawn_file_actions_adddup2(&actions_, STDERR_FILENO, STDOUT_FILENO);
    ::posix_spawn_file_actions_adddup2(&actions_, kAside, kHostSocket);
    if (memory >= 0) {
      ::posix_spawn_file_actions_adddup2(&actions_, kAside + 1, kHostMemory);
    }
    ::posix_spawn_file_actions_addclosefrom_np(&actions_, memory >= 0 ? kHostMemory + 1 : kHostSocket + 1);

    sigset_t none;
    sigemptyset(&none);
    sigset_t all;
    sigfillset(&all);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setpgroup(&attributes_, 0);
    ::posix_spawnattr_setflags(&attributes_,
                               POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
  }
  ~SpawnSettings() {
    ::posix_spawn_file_actions_destroy(&actions_);
    ::posix_spawnattr_destroy(&attributes_);
  }
  SpawnSettings(const SpawnSettings&) = delete;
  SpawnSettings& operator=(const SpawnSettings&) = delete;

  const posix_spawn_file_actions_t* actions() const { return &actions_; }
  const posix_spawnattr_t* attributes() const { return &attributes_; }

 private:
  posix_spawn_file_actions_t actions_{};
  posix_spawnattr_t attributes_{};
};

std::string describe_end(int status) {
  if (WIFSIGNALED(status)) {
    const char* name = ::sigabbrev_np(WTERMSIG(status));
    return name != nullptr ? fmt::format("was ended by SIG{}", name)
                           : fmt::format("was ended by signal {}", WTERMSIG(status));
  }
  return fmt::format("ended with status {}", WEXITSTATUS(status));
}

}  // namespace

std::filesystem::path host_program() {
  constexpr const char* kName = "facet-camera-host";
  if (const char* set = std::getenv("FACET_CAMERA_HOST"); set != nullptr && *set != '\0') {
    return set;
  }
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  // Beside, as installed, and as built: tools/ and daemon/service/ of the build folder.
  for (const char* place : {".", "../lib/facet", "../drivers/camera", "../../drivers/camera"}) {
    const std::filesystem::path program = folder / place / kName;
    if (::access(program.c_str(), X_OK) == 0) {
      return program.lexically_normal();
    }
  }
  fail(fmt::format("{} is neither beside {} nor in ../lib/facet: install it, or set FACET_CAMERA_HOST", kName,
                   folder.string()));
}

HostProcess::Descriptor::~Descriptor() {
  if (fd_ >= 0) {
    ::close(fd_);
  }
}

HostProcess::HostProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                         std::size_t picture_bytes)
    : picture_bytes_(picture_bytes) {
  stragglers().bury();
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0) {
    fail("no socket for a camera's process", errno);
  }
  socket_ = Descriptor(ends[0]);
  const Descriptor host_socket(ends[1]);
  try {
    const Descriptor memory = picture_bytes_ > 0 ? share_picture() : Descriptor();
    spawn(program, arguments, host_socket.get(), memory.get());
  } catch (...) {
    if (picture_ != nullptr) {
      ::munmap(const_cast<std::uint8_t*>(picture_), picture_bytes_);
    }
    throw;
  }
}

HostProcess::~HostProcess() {
  if (!ended_) {
    ::kill(-pid_, SIGKILL);
    if (!reap(kKillPatience_ms)) {
      stragglers().add(pid_);
    }
  }
  if (picture_ != nullptr) {
    ::munmap(const_cast<std::uint8_t*>(picture_), picture_bytes_);
  }
}

/// Memory that the other side can write into and can't make smaller, which would end the reader with SIGBUS.
HostProcess::Descriptor HostProcess::share_picture() {
  Descriptor memory(::memfd_create("facet-camera", MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (memory.get() < 0 || ::ftruncate(memory.get(), static_cast<off_t>(picture_bytes_)) != 0 ||
      ::fcntl(memory.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    fail("no memory for a camera's process", errno);
  }
  void* start = ::mmap(nullptr, picture_bytes_, PROT_READ, MAP_SHARED, memory.get(), 0);
  if (start == MAP_FAILED) {
    fail("no memory for a camera's process", errno);
  }
  picture_ = static_cast<const std::uint8_t*>(start);
  return memory;
}

void HostProcess::spawn(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                        int host_socket, int memory) {
  std::vector<std::string> words = arguments;
  words.insert(words.begin(), {program.string(), fmt::format("--parent={}", ::getpid())});
  std::vector<char*> argv;
  argv.reserve(words.size() + 1);
  for (std::string& word : words) {
    argv.push_back(word.data());
  }
  argv.push_back(nullptr);
  const SpawnSettings settings(host_socket, memory);
  const int error =
      ::posix_spawn(&pid_, program.c_str(), settings.actions(), settings.attributes(), argv.data(), environ);
  if (error != 0) {
    fail(program.string(), error);
  }
  // glibc 2.36 has pidfd_open, but its header can't be used from C++.
  process_ = Descriptor(static_cast<int>(::syscall(SYS_pidfd_open, pid_, 0)));
  if (process_.get() < 0) {
    const int reason = errno;
    ::kill(-pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
    fail("pidfd_open (Linux 5.3 or newer)", reason);
  }
}

void HostProcess::request_frame() {
  // A process that is gone is found by `receive`, after its last message.
  [[maybe_unused]] const ssize_t sent =
      ::send(socket_.get(), &kFrameRequest, sizeof kFrameRequest, MSG_DONTWAIT | MSG_NOSIGNAL);
}

std::optional<HostMessage> HostProcess::receive() {
  std::array<std::uint8_t, kMaxHostMessage_bytes> bytes;
  ssize_t size = 0;
  do {
    size = ::recv(socket_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_TRUNC);
  } while (size < 0 && errno == EINTR);
  if (size < 0 && (errno == EAGAIN || errno == EWOULDBLOCK) && !seen_ended_) {
    return std::nullopt;
  }
  if (size <= 0) {
    tell_end();
  }
  if (static_cast<std::size_t>(size) > bytes.size()) {
    fail(fmt::format("its process sent a message of {} bytes", size));
  }
  std::string wrong;
  std::optional<HostMessage> message =
      read_host_message({bytes.data(), static_cast<std::size_t>(size)}, wrong);
  if (!message) {
    fail("its process sent " + wrong);
  }
  return message;
}

void HostProcess::tell_end() {
  constexpr int kPatience_ms = 1000;  // a core dump takes time
  if (!reap(kPatience_ms)) {
    fail("its process closed its socket and goes on");
  }
  fail("its process " + describe_end(status_));
}

void HostProcess::wait(std::int64_t until_ns) {
  // The process too: its socket stays open while something that it started has it.
  std::array<pollfd, 2> watched = {pollfd{socket_.get(), POLLIN, 0}, pollfd{process_.get(), POLLIN, 0}};
  const std::int64_t left_ns = std::max<std::int64_t>(0, until_ns - Clock::now_ns());
  const timespec left{left_ns / kSecond_ns, left_ns % kSecond_ns};
  // Ends early with EINTR: the caller looks and waits again.
  if (::ppoll(watched.data(), watched.size(), &left, nullptr) > 0) {
    seen_ended_ = watched[1].revents != 0;
  }
}

/// Waits for the end of the process and takes its status.
bool HostProcess::reap(int patience_ms) {
  pollfd end{process_.get(), POLLIN, 0};
  const std::int64_t until_ns = Clock::now_ns() + std::int64_t{patience_ms} * 1'000'000;
  while (!ended_) {
    // It stays a zombie until its group, which has its number, is ended with it.
    siginfo_t info{};
    const bool waited = ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0;
    const std::int64_t left_ns = until_ns - Clock::now_ns();
    if (!waited || info.si_pid == pid_) {
      ::kill(-pid_, SIGKILL);
      ::waitpid(pid_, &status_, 0);
      ended_ = true;
    } else if (left_ns <= 0) {
      return false;
    } else {
      ::poll(&end, 1, static_cast<int>(left_ns / 1'000'000) + 1);
    }
  }
  return true;
}

void HostProcess::end_gently(int patience_ms) {
  ::shutdown(socket_.get(), SHUT_RDWR);
  reap(patience_ms);
}

}  // namespace facet::camera
