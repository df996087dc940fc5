#pragma once

#include <sys/socket.h>

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

namespace facet::avatar {

enum class BridgeProtocol { Vmc, LiveLinkFace, IFacialMocap, VrChat, VTubeStudio, VTubeStudioPlugin };

/// A protocol in the configuration and in messages.
struct BridgeProtocolNames {
  BridgeProtocol protocol;
  const char* key;           ///< of [bridges]: a list of targets
  std::uint16_t usual_port;  ///< where its receivers listen unless told otherwise
  bool is_tcp = false;       ///< its receivers take connections; else UDP
};
inline constexpr std::array<BridgeProtocolNames, 6> kBridgeProtocols = {{
    {BridgeProtocol::Vmc, "vmc", 39539},
    {BridgeProtocol::LiveLinkFace, "live_link_face", 11111},
    {BridgeProtocol::IFacialMocap, "ifacialmocap", 49983},
    {BridgeProtocol::VrChat, "vrchat", 9000},
    {BridgeProtocol::VTubeStudio, "vtube_studio", 11125},
    {BridgeProtocol::VTubeStudioPlugin, "vtube_studio_plugin", 8001, true},
}};
/// As the configuration names it.
const char* to_string(BridgeProtocol protocol);

/// Where a bridge sends to.
struct BridgeTarget {
  BridgeProtocol protocol = BridgeProtocol::Vmc;
  std::string address;  ///< IPv4 or IPv6 in digits, or the name of a host
  std::uint16_t port = 0;

  std::string text() const;  ///< "ADDRESS:PORT", "[ADDRESS]:PORT" for IPv6
};

/// Reads "ADDRESS:PORT", "[ADDRESS]:PORT" or "HOST:PORT"; nothing where it is none. No name is looked up.
std::optional<BridgeTarget> parse_target(BridgeProtocol protocol, const std::string& text);

/// Of UDP. Length 0: none.
struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t length = 0;
};
/// Length 0 where the text is no address in digits.
SocketAddress socket_address(const std::string& address, std::uint16_t port);
/// Whether two are of the same machine, whatever their ports; the second: with the ports. Of IP; one of
/// length 0 is like none.
bool same_host(const SocketAddress& one, const SocketAddress& other);
bool same_address(const SocketAddress& one, const SocketAddress& other);
/// What a socket sends ends at the first router. False where the system does not let it. family: the
/// socket's, AF_INET or AF_INET6, which sends to IPv4 addresses too (::ffff:A.B.C.D).
bool keep_in_network(int socket, int family);

/// What became of a host's name.
struct LookedUp {
  SocketAddress address;
  std::string trouble;  ///< why there is none
};
using LookUp = std::function<LookedUp(const BridgeTarget&)>;
/// Asks the resolver, for seconds where it does not answer: the host's first IPv4 address, else its first.
/// Receivers of these protocols rarely listen on others. Any thread.
LookedUp look_up_host(const BridgeTarget& target);

/// Whether a program of this machine has the address and port for itself.
enum class Listener {
  Somebody,
  Nobody,
  OtherMachine  ///< it is no address of this one
};
/// Tries to have it for a moment. Any thread.
Listener who_listens(const SocketAddress& address, bool is_tcp = false);

}  // namespace facet::avatar
