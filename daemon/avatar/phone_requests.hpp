#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "avatar/phone_messages.hpp"

namespace facet::avatar {

/// A program on a PC that asks a phone for its face, and to which of its ports it wants it.
struct PhoneRequest {
  BridgeProtocol protocol = BridgeProtocol::IFacialMocap;  ///< or VTubeStudio
  std::vector<std::uint16_t> ports;                        ///< 1 to 16, none of them 0
  std::chrono::milliseconds lasting{0};                    ///< from now on
  IFacialMocapVersion version = IFacialMocapVersion::V1;   ///< of IFacialMocap
};

/// Where phones hear requests.
inline constexpr std::uint16_t kIFacialMocapPort = 49983;
inline constexpr std::uint16_t kVTubeStudioPort = 21412;
/// iFacialMocap's request has no end of its own, and programs send it once.
inline constexpr std::chrono::hours kIFacialMocapLasts{1};
inline constexpr std::size_t kMostRequestBytes = 1024;

/// Reads a datagram from anybody: "iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719", alone or with "|"
/// and options behind it, "|" between them, of which "sendDataVersion=v2" alone is heeded (answered at port
/// 49983); or VTube Studio's JSON with "messageType": "iOSTrackingDataRequest", "time" (0.5 to 10 s) and
/// "ports". Nothing where it is neither. Any thread.
std::optional<PhoneRequest> parse_phone_request(std::string_view datagram);

/// Somebody who asked.
struct Asker {
  BridgeProtocol protocol = BridgeProtocol::IFacialMocap;
  SocketAddress address;  ///< with the port at which it wants its answers; IPv4 as such
  std::chrono::milliseconds lasting{0};
  IFacialMocapVersion version = IFacialMocapVersion::V1;

  /// The address in digits.
  BridgeTarget target() const;
};

/// Hears such requests. One thread.
class PhoneRequests {
 public:
  /// address: this machine's, in digits. See fault().
  explicit PhoneRequests(const std::string& address);
  ~PhoneRequests();
  PhoneRequests(const PhoneRequests&) = delete;
  PhoneRequests& operator=(const PhoneRequests&) = delete;

  /// Why a port is not listened at (another program has it); empty: both are.
  const std::string& fault() const { return fault_; }
  /// Whether a datagram is read, by who sent it; else it is passed over.
  using Welcome = std::function<bool(const SocketAddress& from)>;
  using Take = std::function<void(const Asker& asker)>;
  /// Hands over who has asked since the last call, of 64 datagrams at most. Waits for nothing.
  void hear(const Welcome& welcome, const Take& take) const;

 private:
  std::vector<int> sockets_;
  std::string fault_;
};

}  // namespace facet::avatar
