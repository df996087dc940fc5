#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "avatar/bridge_target.hpp"

namespace facet::avatar {

/// A program on a PC that asks a phone for its face, and to which of its ports it wants it.
struct PhoneRequest {
  BridgeProtocol protocol = BridgeProtocol::IFacialMocap;  ///< or VTubeStudio
  std::vector<std::uint16_t> ports;                        ///< 1 to 16, none of them 0
  std::chrono::milliseconds lasting{0};                    ///< from now on
};

/// Where phones hear requests.
inline constexpr std::uint16_t kIFacialMocapPort = 49983;
inline constexpr std::uint16_t kVTubeStudioPort = 21412;
/// iFacialMocap's request has no end of its own, and programs send it once.
inline constexpr std::chrono::hours kIFacialMocapLasts{1};
inline constexpr std::size_t kMostRequestBytes = 1024;

/// Reads a datagram from anybody: "iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719", alone or with "|"
/// and options behind it, of which none is heeded (answered at port 49983); or VTube Studio's JSON with
/// "messageType": "iOSTrackingDataRequest", "time" (0.5 to 10 s) and "ports". Nothing where it is neither.
/// Any thread.
std::optional<PhoneRequest> parse_phone_request(std::string_view datagram);

/// Somebody who asked.
struct Asker {
  BridgeTarget target;
  SocketAddress address;
  std::chrono::milliseconds lasting{0};
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
  /// Who has asked since the last call, of 64 datagrams at most. Waits for nothing.
  std::vector<Asker> heard() const;

 private:
  std::vector<int> sockets_;
  std::string fault_;
};

}  // namespace facet::avatar
