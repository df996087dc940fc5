#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>

#include "facet/clock.hpp"

namespace facet::stream {

/// Owns a file descriptor.
class FileDescriptor {
 public:
  FileDescriptor() = default;
  explicit FileDescriptor(int fd) : fd_(fd) {}
  FileDescriptor(FileDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept {
    if (this != &other) {
      reset(std::exchange(other.fd_, -1));
    }
    return *this;
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  ~FileDescriptor() { reset(); }

  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }
  void reset(int fd = -1);

 private:
  int fd_ = -1;
};

/// A socket's path has no more bytes (sockaddr_un).
inline constexpr std::size_t kMaxSocketPathBytes = 107;

/// Who may connect to a socket.
struct SocketAccess {
  unsigned mode = 0660;
  std::string group;  ///< name; empty: the process's own
};

/// The process at the other end of a connection, as it was when it connected.
struct UnixPeer {
  std::int32_t pid = 0;
  std::uint32_t uid = 0;
  bool may_command = false;
};

/// A listening Unix stream socket. One that was bound here owns its path: the destructor removes the path if
/// it is still this socket.
class ListeningSocket {
 public:
  /// Binds and listens, non-blocking. A socket file that nobody listens on any more is replaced. Throws
  /// Error(Storage) where the path is taken (by a running server or by another kind of file), its folder is
  /// missing or closed to us, or the path is too long, and Error(Usage) where the group does not exist or we
  /// are not in it. Nobody can connect before mode and group are set.
  ///
  /// passed: where given, this listening socket is used instead of a new one; whoever bound it (the service
  /// manager) owns its path, mode and group. Throws Error(Usage) where it is no listening Unix stream socket
  /// or its path is not `path`.
  ListeningSocket(const std::filesystem::path& path, const SocketAccess& access, FileDescriptor passed = {});
  ~ListeningSocket();
  ListeningSocket(const ListeningSocket&) = delete;
  ListeningSocket& operator=(const ListeningSocket&) = delete;

  /// Nobody can connect any more; a path that is ours is removed. Idempotent.
  void close();

  int fd() const { return fd_.get(); }
  const std::filesystem::path& path() const { return path_; }

  /// The next connection that waits, non-blocking; none: nobody waits. One for which no descriptor is left is
  /// closed, and `turned_away` counted; where the system has not even the memory to do that, this waits 10
  /// ms, as fd() stays readable and would wake its loop without end.
  FileDescriptor accept();
  std::uint64_t turned_away() const { return turned_away_; }

  /// Root, our own user and members of the socket's group may command; nobody where the connection does not
  /// say who it is.
  UnixPeer peer(int connection) const;

 private:
  std::filesystem::path path_;
  FileDescriptor fd_;
  gid_t group_ = static_cast<gid_t>(-1);  ///< of the path, as it was when we began to listen
  bool owns_path_ = false;
  std::uint64_t device_ = 0;
  std::uint64_t inode_ = 0;
  FileDescriptor spare_;  ///< given up for a moment to turn a connection away
  std::uint64_t turned_away_ = 0;
};

/// The end of a wait. Every call that waits for a peer has one, whatever it waits for in between.
using Deadline = Clock::time_point;

/// Connects to a Unix stream socket; what comes back blocks. Throws Error(Unavailable) saying what is wrong:
/// no such socket, nobody listens, no permission (and which group would have it), or a queue that stayed full
/// up to the deadline, as that of a stopped program does.
FileDescriptor connect_unix(const std::filesystem::path& path, Deadline deadline);
FileDescriptor connect_unix(const std::filesystem::path& path);  ///< the same, with 10 seconds

/// Waits until a descriptor can be read (POLLIN) or written (POLLOUT), as `events` says, or has failed. False
/// at the deadline. Throws Error(Internal).
bool wait_for(int fd, short events, Deadline deadline);

}  // namespace facet::stream
