#include "stream/unix_socket.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <grp.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::stream {
namespace {

constexpr int kBacklog = 64;

std::string reason(int error) {
  return std::strerror(error);
}

sockaddr_un address_of(const std::filesystem::path& path, ErrorKind kind) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string name = path.string();
  static_assert(kMaxSocketPathBytes + 1 == sizeof(address.sun_path));
  if (name.empty() || name.size() > kMaxSocketPathBytes) {
    throw Error(kind, fmt::format("socket path '{}' must have 1 to {} bytes: choose a shorter folder", name,
                                  kMaxSocketPathBytes));
  }
  std::memcpy(address.sun_path, name.data(), name.size());
  return address;
}

FileDescriptor make_socket(int flags) {
  FileDescriptor fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | flags, 0));
  if (!fd) {
    throw Error(kind_of_errno(errno, ErrorKind::Internal),
                fmt::format("cannot make a socket: {}", describe_errno(errno)));
  }
  return fd;
}

/// 0 or errno.
int try_connect(int fd, const sockaddr_un& address) {
  // The socket API takes every address as a sockaddr.
  return ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0 ? 0 : errno;
}

std::optional<gid_t> group_id(const std::string& name) {
  std::vector<char> buffer(16384);
  group entry{};
  group* found = nullptr;
  const int error = ::getgrnam_r(name.c_str(), &entry, buffer.data(), buffer.size(), &found);
  if (may_pass(error)) {
    throw Error(kind_of_errno(error), fmt::format("group '{}': {}", name, describe_errno(error)));
  }
  return error == 0 && found != nullptr ? std::optional<gid_t>(found->gr_gid) : std::nullopt;
}

std::string group_name(gid_t id) {
  std::vector<char> buffer(16384);
  group entry{};
  group* found = nullptr;
  const int error = ::getgrgid_r(id, &entry, buffer.data(), buffer.size(), &found);
  return error == 0 && found != nullptr ? std::string(found->gr_name) : std::to_string(id);
}

/// Removes a socket file that nobody listens on; throws where the path is in use.
void clear_stale(const std::filesystem::path& path, const sockaddr_un& address) {
  struct stat status {};
  if (::lstat(path.c_str(), &status) != 0) {
    if (errno == ENOENT) {
      return;
    }
    throw Error(ErrorKind::Storage, fmt::format("socket '{}': {}", path.string(), reason(errno)));
  }
  if (!S_ISSOCK(status.st_mode)) {
    throw Error(
        ErrorKind::Storage,
        fmt::format("socket path '{}' is taken by a file that is not a socket: move it away or choose "
                    "another path",
                    path.string()));
  }
  const FileDescriptor probe = make_socket(SOCK_NONBLOCK);
  const int error = try_connect(probe.get(), address);
  if (error != ECONNREFUSED) {
    throw Error(
        ErrorKind::Storage,
        fmt::format("socket '{}' is in use by another running program ({}): stop it or choose another "
                    "path",
                    path.string(), error == 0 ? "it answers" : reason(error)));
  }
  if (::unlink(path.c_str()) != 0 && errno != ENOENT) {
    throw Error(ErrorKind::Storage,
                fmt::format("cannot remove the stale socket '{}': {}", path.string(), reason(errno)));
  }
}

void bind_to(int fd, const std::filesystem::path& path, const sockaddr_un& address) {
  if (::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0) {
    return;
  }
  const int error = errno;
  const std::string folder = path.has_parent_path() ? path.parent_path().string() : ".";
  if (error == ENOENT) {
    throw Error(ErrorKind::Storage,
                fmt::format("socket '{}': the folder '{}' does not exist: create it", path.string(), folder));
  }
  if (error == EACCES || error == EPERM || error == EROFS) {
    throw Error(ErrorKind::Storage,
                fmt::format("socket '{}': cannot write to the folder '{}' ({}): give this user the right or "
                            "choose another path",
                            path.string(), folder, reason(error)));
  }
  throw Error(ErrorKind::Storage, fmt::format("cannot bind socket '{}': {}", path.string(), reason(error)));
}

void set_access(const std::filesystem::path& path, const SocketAccess& access) {
  if (!access.group.empty()) {
    const std::optional<gid_t> id = group_id(access.group);
    if (!id) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("socket '{}': there is no group '{}': create it (groupadd --system {}) or change "
                      "the configuration",
                      path.string(), access.group, access.group));
    }
    if (::chown(path.c_str(), static_cast<uid_t>(-1), *id) != 0) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("socket '{}': cannot hand it to the group '{}' ({}): this user must be a member",
                      path.string(), access.group, reason(errno)));
    }
  }
  if (::chmod(path.c_str(), static_cast<mode_t>(access.mode & 0777U)) != 0) {
    throw Error(ErrorKind::Storage,
                fmt::format("socket '{}': cannot set its permissions: {}", path.string(), reason(errno)));
  }
}

int socket_option(int fd, int option) {
  int value = 0;
  socklen_t size = sizeof(value);
  return ::getsockopt(fd, SOL_SOCKET, option, &value, &size) == 0 ? value : -1;
}

/// Throws where a socket that somebody else bound is not what it must be; else makes it non-blocking.
void check_passed(int fd, const std::filesystem::path& path) {
  sockaddr_un address{};
  // One byte is kept back: a path of full length is not terminated.
  socklen_t size = sizeof(address) - 1;
  if (socket_option(fd, SO_DOMAIN) != AF_UNIX || socket_option(fd, SO_TYPE) != SOCK_STREAM ||
      socket_option(fd, SO_ACCEPTCONN) != 1 ||
      ::getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("what the service manager passes for '{}' is not a listening Unix stream socket: "
                            "its unit needs ListenStream= and Accept=no",
                            path.string()));
  }
  const std::filesystem::path bound = address.sun_path;
  if (std::filesystem::absolute(bound).lexically_normal() !=
      std::filesystem::absolute(path).lexically_normal()) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("the configuration names the socket '{}', but the service manager listens on '{}': "
                    "set ListenStream= of its socket unit, or the configuration, to the other's path",
                    path.string(), bound.string()));
  }
  ::fcntl(fd, F_SETFL, ::fcntl(fd, F_GETFL) | O_NONBLOCK);
  ::fcntl(fd, F_SETFD, FD_CLOEXEC);
}

bool is_member(int fd, gid_t primary, gid_t wanted) {
  std::vector<gid_t> groups(64);
  socklen_t size = static_cast<socklen_t>(groups.size() * sizeof(gid_t));
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERGROUPS, groups.data(), &size) != 0) {
    // ERANGE: `size` now says how much it takes.
    groups.resize(size / sizeof(gid_t));
    if (errno != ERANGE || ::getsockopt(fd, SOL_SOCKET, SO_PEERGROUPS, groups.data(), &size) != 0) {
      return primary == wanted;
    }
  }
  groups.resize(size / sizeof(gid_t));
  return primary == wanted || std::find(groups.begin(), groups.end(), wanted) != groups.end();
}

gid_t group_of(const std::filesystem::path& path) {
  struct stat status {};
  return ::stat(path.c_str(), &status) == 0 ? status.st_gid : static_cast<gid_t>(-1);
}

FileDescriptor open_spare() {
  return FileDescriptor(::open("/dev/null", O_RDONLY | O_CLOEXEC));
}

/// At least a millisecond: 0 would be without end.
timeval time_until(Deadline deadline) {
  const auto left = std::max<std::chrono::microseconds>(
      std::chrono::ceil<std::chrono::microseconds>(deadline - Clock::now()), std::chrono::milliseconds(1));
  const auto whole = std::chrono::duration_cast<std::chrono::seconds>(left);
  return {whole.count(), (left - whole).count()};
}

}  // namespace

bool wait_for(int fd, short events, Deadline deadline) {
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()).count();
    pollfd entry{fd, events, 0};
    const int ready = ::poll(&entry, 1, static_cast<int>(std::clamp<std::int64_t>(left, 0, 1 << 30)));
    if (ready >= 0) {
      return ready > 0;
    }
    if (errno != EINTR) {
      throw Error(ErrorKind::Internal, fmt::format("cannot wait for a socket: {}", reason(errno)));
    }
  }
}

void FileDescriptor::reset(int fd) {
  if (fd_ >= 0) {
    ::close(fd_);
  }
  fd_ = fd;
}

ListeningSocket::ListeningSocket(const std::filesystem::path& path, const SocketAccess& access,
                                 FileDescriptor passed)
    : path_(path), spare_(open_spare()) {
  if (passed) {
    check_passed(passed.get(), path);
    fd_ = std::move(passed);
    group_ = group_of(path);
    return;
  }
  const sockaddr_un address = address_of(path, ErrorKind::Usage);
  clear_stale(path, address);
  fd_ = make_socket(SOCK_NONBLOCK);
  bind_to(fd_.get(), path, address);
  owns_path_ = true;
  // Until listen, every connect is refused: nobody comes in before the permissions stand.
  try {
    struct stat status {};
    if (::lstat(path.c_str(), &status) == 0) {
      device_ = status.st_dev;
      inode_ = status.st_ino;
    }
    set_access(path, access);
    group_ = group_of(path);
    if (::listen(fd_.get(), kBacklog) != 0) {
      throw Error(ErrorKind::Storage,
                  fmt::format("cannot listen on socket '{}': {}", path.string(), reason(errno)));
    }
  } catch (const Error&) {
    ::unlink(path.c_str());
    throw;
  }
}

ListeningSocket::~ListeningSocket() {
  close();
}

void ListeningSocket::close() {
  fd_.reset();
  struct stat status {};
  if (std::exchange(owns_path_, false) && ::lstat(path_.c_str(), &status) == 0 && status.st_dev == device_ &&
      status.st_ino == inode_) {
    ::unlink(path_.c_str());
  }
}

FileDescriptor ListeningSocket::accept() {
  constexpr useconds_t kRestUs = 10'000;
  for (;;) {
    FileDescriptor connection(::accept4(fd_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (connection || errno == EAGAIN) {
      return connection;
    }
    if (errno == EINTR || errno == ECONNABORTED) {
      continue;
    }
    spare_.reset();
    const bool taken =
        static_cast<bool>(FileDescriptor(::accept4(fd_.get(), nullptr, nullptr, SOCK_CLOEXEC)));
    spare_ = open_spare();
    if (!taken) {
      ::usleep(kRestUs);
      return {};
    }
    ++turned_away_;
    return {};
  }
}

UnixPeer ListeningSocket::peer(int connection) const {
  ucred peer{};
  socklen_t size = sizeof(peer);
  if (::getsockopt(connection, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) {
    return {};
  }
  const bool may_command =
      peer.uid == 0 || peer.uid == ::geteuid() || is_member(connection, peer.gid, group_);
  return {peer.pid, peer.uid, may_command};
}

FileDescriptor connect_unix(const std::filesystem::path& path) {
  constexpr auto kPatience = std::chrono::seconds(10);
  return connect_unix(path, Clock::now() + kPatience);
}

FileDescriptor connect_unix(const std::filesystem::path& path, Deadline deadline) {
  const sockaddr_un address = address_of(path, ErrorKind::Usage);
  FileDescriptor fd = make_socket(0);
  // A Unix socket's connect can't be polled for: it waits for a place in the queue as long as a send may
  // take.
  int error = EINTR;
  for (bool first = true; error == EINTR && (first || Clock::now() < deadline); first = false) {
    const timeval patience = time_until(deadline);
    ::setsockopt(fd.get(), SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof(patience));
    error = try_connect(fd.get(), address);
  }
  if (error == 0) {
    const timeval forever{};
    ::setsockopt(fd.get(), SOL_SOCKET, SO_SNDTIMEO, &forever, sizeof(forever));
    return fd;
  }
  if (error == EAGAIN || error == EINTR) {
    throw Error(
        ErrorKind::Unavailable,
        fmt::format("the program at the socket '{}' does not answer: it is stopped, or has more to do "
                    "than it can",
                    path.string()));
  }
  if (error == EACCES) {
    struct stat status {};
    const std::string group =
        ::stat(path.c_str(), &status) == 0 ? group_name(status.st_gid) : std::string("its owner");
    throw Error(ErrorKind::Unavailable,
                fmt::format("no permission for the socket '{}': this user must be a member of the group '{}'",
                            path.string(), group));
  }
  if (error == ENOENT || error == ECONNREFUSED) {
    throw Error(
        ErrorKind::Unavailable,
        fmt::format("nobody answers at the socket '{}': is facetd running with this path?", path.string()));
  }
  throw Error(ErrorKind::Unavailable,
              fmt::format("cannot connect to the socket '{}': {}", path.string(), reason(error)));
}

}  // namespace facet::stream
