#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "avatar/oscquery.hpp"

namespace facet::avatar {

/// Which VRChats are looked for.
enum class VrChatFind { Off, Machine, Network };
inline constexpr std::array kVrChatFinds = {"off", "machine", "network"};

struct VrChatFinderConfig {
  VrChatFind where = VrChatFind::Off;
  /// Each is asked again, and others are looked for.
  std::chrono::milliseconds every = std::chrono::seconds(5);
  std::chrono::milliseconds patience = std::chrono::seconds(2);  ///< for one answer over HTTP
  SocketAddress asked = socket_address("224.0.0.251", 5353);     ///< multicast DNS
};

/// One of this machine's networks.
struct OwnNetwork {
  SocketAddress address;   ///< this machine's own, of IPv4
  std::uint32_t mask = 0;  ///< as in the address, the most significant byte first
};
enum class Nearness { Own, Near, Far };
/// Whether an address is this machine's, in one of its networks, or behind a router. Any thread.
Nearness nearness(const SocketAddress& address, std::span<const OwnNetwork> networks);

/// A VRChat that answers.
struct FoundVrChat {
  std::string name;                      ///< "VRChat-Client-A1B2C3"
  std::vector<SocketAddress> addresses;  ///< of its OSC, all of the same machine; the first is sent to
  std::shared_ptr<const AvatarParameters> avatar;  ///< null: not known

  /// The first address in digits.
  BridgeTarget target() const;
};
inline constexpr std::size_t kMostFoundVrChats = 4;

/// Looks for VRChats by one-shot questions of multicast DNS over IPv4, on every network of this machine, and
/// asks each over HTTP where its OSC is and what its avatar has, again and again, all at the same time, on a
/// thread of its own, `facet-vrchat`. Only the machine that answered is asked and told of, and only where it
/// is this one or in a network of this one's (RFC 6762, section 11); what is sent to it ends at the first
/// router. One that has failed twice in a row is gone.
class VrChatFinder {
 public:
  explicit VrChatFinder(const VrChatFinderConfig& config);
  ~VrChatFinder();
  VrChatFinder(const VrChatFinder&) = delete;
  VrChatFinder& operator=(const VrChatFinder&) = delete;

  void start();
  void request_stop();  ///< any thread; the thread ends at once
  void stop();

  /// Those that answer, 4 at most. Any thread.
  std::vector<FoundVrChat> found() const;
  /// How often found() has become another. Any thread.
  std::uint64_t changes() const;
  /// Why nothing can be looked for now; empty: it can. Any thread.
  std::string fault() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::avatar
