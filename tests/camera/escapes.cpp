#include "escapes.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sched.h>
#include <spawn.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <fstream>

namespace facet::test {
namespace {

using Guard = Escape::Guard;

bool opens(const std::filesystem::path& file, int flags) {
  const int fd = ::open(file.c_str(), flags | O_CLOEXEC, 0600);
  if (fd >= 0) {
    ::close(fd);
  }
  return fd >= 0;
}

template <typename Address>
bool connects(int family, int type, const Address& address) {
  const int fd = ::socket(family, type | SOCK_CLOEXEC, 0);
  const bool connected =
      fd >= 0 && ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  if (fd >= 0) {
    ::close(fd);
  }
  return connected;
}

sockaddr_in address_of(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  return address;
}

sockaddr_un address_of(const std::filesystem::path& file) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, file.c_str(), sizeof address.sun_path - 1);
  return address;
}

/// Whether a child ends with 0.
bool ends_well(pid_t child) {
  int status = -1;
  return child > 0 && ::waitpid(child, &status, 0) == child && status == 0;
}

bool starts_program() {
  std::array<char*, 1> none = {nullptr};
  pid_t child = -1;
  return ::posix_spawn(&child, "/bin/true", nullptr, nullptr, none.data(), none.data()) == 0 &&
         ends_well(child);
}

bool forks() {
  const pid_t child = ::fork();
  if (child == 0) {
    ::_exit(0);
  }
  return ends_well(child);
}

/// The kernel then sends any signal, SIGKILL too, in this process's name.
bool has_its_parent_signalled() {
  std::array<int, 2> ends{};
  return ::pipe(ends.data()) == 0 && ::fcntl(ends[0], F_SETOWN, ::getppid()) == 0;
}

bool slows_its_parent() {
  return ::setpriority(PRIO_PROCESS, static_cast<id_t>(::getppid()), 19) == 0;
}

bool limits_its_parent() {
  rlimit limit{};
  return ::syscall(SYS_prlimit64, ::getppid(), RLIMIT_CORE, nullptr, &limit) == 0 &&
         ::syscall(SYS_prlimit64, ::getppid(), RLIMIT_CORE, &limit, nullptr) == 0;
}

bool looks_into_its_parent() {
  static int here = 0;
  iovec mine{&here, sizeof here};
  iovec theirs{&here, sizeof here};
  return ::process_vm_readv(::getppid(), &mine, 1, &theirs, 1, 0) > 0;
}

/// Whether the kernel did as it was told, or would do with other arguments: whether the call got to it.
template <typename... Arguments>
bool reaches(long call, Arguments... arguments) {
  return ::syscall(call, arguments...) >= 0 || errno != ENOSYS;
}

}  // namespace

void make_treasures(const std::filesystem::path& folder) {
  for (const char* name : {"a.take", "token", "configuration"}) {
    std::ofstream(folder / name) << "treasure";
  }
}

std::vector<Escape> escapes(const Surroundings& around) {
  const std::filesystem::path take = around.folder / "a.take";
  return {
      {"read the token", Guard::Files, [=] { return opens(around.folder / "token", O_RDONLY); }},
      {"read the configuration", Guard::Files,
       [=] { return opens(around.folder / "configuration", O_RDONLY); }},
      {"list the takes", Guard::Files, [=] { return opens(around.folder, O_RDONLY | O_DIRECTORY); }},
      {"write into a take", Guard::Files, [=] { return opens(take, O_RDWR); }},
      {"see its parent's descriptors", Guard::Files,
       [] { return opens("/proc/" + std::to_string(::getppid()) + "/fd", O_RDONLY | O_DIRECTORY); }},
      {"make a file", Guard::Calls, [=] { return opens(around.folder / "new", O_WRONLY | O_CREAT); }},
      {"make a file without name", Guard::Calls, [=] { return opens(around.folder, O_RDWR | O_TMPFILE); }},
      {"make a folder", Guard::Calls, [=] { return ::mkdir((around.folder / "folder").c_str(), 0700) == 0; }},
      {"give a take another name", Guard::Calls,
       [=] { return ::link(take.c_str(), (around.folder / "link").c_str()) == 0; }},
      {"lay a link", Guard::Calls,
       [=] { return ::symlink("a.take", (around.folder / "soft").c_str()) == 0; }},
      {"open a take to all", Guard::Calls, [=] { return ::chmod(take.c_str(), 0666) == 0; }},
      {"empty a take", Guard::Calls, [=] { return opens(take, O_WRONLY | O_TRUNC); }},
      {"shorten a take", Guard::Calls, [=] { return ::truncate(take.c_str(), 1) == 0; }},
      {"rename a take", Guard::Calls,
       [=] { return ::rename(take.c_str(), (around.folder / "moved").c_str()) == 0; }},
      {"remove the token", Guard::Calls, [=] { return ::unlink((around.folder / "token").c_str()) == 0; }},
      {"connect to another machine", Guard::Calls,
       [=] { return connects(AF_INET, SOCK_STREAM, address_of(around.port)); }},
      {"send a datagram", Guard::Calls,
       [=] { return connects(AF_INET, SOCK_DGRAM, address_of(around.port)); }},
      {"command the daemon", Guard::Calls,
       [=] { return connects(AF_UNIX, SOCK_STREAM, address_of(around.folder / "control.sock")); }},
      {"start a program", Guard::Calls, starts_program},
      {"fork", Guard::Calls, forks},
      {"leave its session", Guard::Calls, [] { return ::setsid() > 0; }},
      {"signal its parent", Guard::Calls, [] { return ::kill(::getppid(), 0) == 0; }},
      {"have its parent signalled", Guard::Calls, has_its_parent_signalled},
      {"slow its parent", Guard::Calls, slows_its_parent},
      {"limit its parent", Guard::Calls, limits_its_parent},
      {"look into its parent", Guard::CallsOnly, looks_into_its_parent},
      {"trace its parent", Guard::CallsOnly,
       [] { return reaches(SYS_ptrace, 0x4206 /*PTRACE_SEIZE*/, ::getppid(), nullptr, nullptr); }},
      {"mount", Guard::CallsOnly,
       [=] { return reaches(SYS_mount, "", around.folder.c_str(), "none", 0L, nullptr); }},
      {"make a name space", Guard::CallsOnly, [] { return reaches(SYS_unshare, CLONE_FS); }},
      {"load a program into the kernel", Guard::CallsOnly, [] { return reaches(SYS_bpf, 0, nullptr, 0); }},
      {"pass calls by a ring", Guard::CallsOnly, [] { return reaches(SYS_io_uring_setup, 0, nullptr); }},
      {"keep keys", Guard::CallsOnly, [] { return reaches(SYS_keyctl, 0, 0, 0, 0, 0); }},
  };
}

}  // namespace facet::test
