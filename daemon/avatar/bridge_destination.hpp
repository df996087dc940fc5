#pragma once

#include <chrono>
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "avatar/oscquery.hpp"
#include "avatar/phone_messages.hpp"
#include "avatar/vrchat.hpp"
#include "facet/clock.hpp"
#include "stream/unix_socket.hpp"

namespace facet::avatar {

/// Where one of a bridge's targets is, and what was told to it. One thread.
struct BridgeDestination {
  BridgeTarget target;
  SocketAddress address;
  stream::FileDescriptor socket;  ///< none: no address is known
  std::string unknown;            ///< why there is none
  bool connected = false;
  int sound_frames = 0;                                   ///< since the last that failed
  int refusals = 0;                                       ///< since the last frames that went well
  std::optional<Clock::time_point> until;                 ///< of one that asked
  IFacialMocapVersion version = IFacialMocapVersion::V1;  ///< that it asked for last
  bool found = false;                                     ///< it is a VRChat's, and not configured
  std::shared_ptr<const AvatarParameters> avatar;         ///< of a VRChat that answers
  std::unique_ptr<VrChatWriter> writer;                   ///< of that avatar

  /// A socket for this target alone: a refusal that comes back (nobody listens there) is told with the next
  /// datagram. Throws Error(Internal).
  void open();
  /// Waits for nothing. Empty, or what the network said.
  std::string send(const std::vector<std::vector<std::byte>>& datagrams);
  /// Takes what its avatar has; null: that is not known.
  void wear(std::shared_ptr<const AvatarParameters> worn, const MappedValues& chosen);
};

}  // namespace facet::avatar
