#pragma once

#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>
#include <filesystem>
#include <vector>

#include "stream/unix_socket.hpp"

namespace facet::test {

/// Fills the queue of a listening socket from which nobody accepts, as that of a stopped program, until a
/// further connection would wait. The connections, to be kept.
inline std::vector<stream::FileDescriptor> fill_queue(const std::filesystem::path& socket) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, socket.c_str(), sizeof(address.sun_path) - 1);
  std::vector<stream::FileDescriptor> connections;
  for (;;) {
    stream::FileDescriptor fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    if (::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
      return connections;
    }
    connections.push_back(std::move(fd));
  }
}

}  // namespace facet::test
