#include "avatar/bridge_destination.hpp"

#include <fmt/format.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "facet/error.hpp"

namespace facet::avatar {

void BridgeDestination::open() {
  socket.reset(::socket(address.storage.ss_family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket) {
    throw Error(ErrorKind::Internal,
                fmt::format("bridge: cannot open a UDP socket: {}", std::strerror(errno)));
  }
}

std::string BridgeDestination::send(const std::vector<std::vector<std::byte>>& datagrams) {
  if (!socket) {
    return unknown;
  }
  // Where there is no route yet, the next frame tries again.
  if (!connected &&
      ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address.storage), address.length) < 0) {
    return std::strerror(errno);
  }
  connected = true;
  std::string reason;
  for (const std::vector<std::byte>& datagram : datagrams) {
    if (::send(socket.get(), datagram.data(), datagram.size(), MSG_NOSIGNAL) < 0) {
      reason = errno == EAGAIN ? "the network is busy" : std::strerror(errno);
    }
  }
  return reason;
}

void BridgeDestination::wear(std::shared_ptr<const AvatarParameters> worn, const MappedValues& chosen) {
  avatar = std::move(worn);
  writer = avatar != nullptr ? std::make_unique<VrChatWriter>(chosen, avatar.get()) : nullptr;
}

}  // namespace facet::avatar
