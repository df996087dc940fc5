#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace facet::avatar {

// What VRChat tells of itself (https://github.com/Vidvox/OSCQueryProposal): where it listens for OSC and
// which parameters its avatar has, over HTTP at a port that multicast DNS names (RFC 6762, RFC 6763). All of
// it comes from anybody in the network; any thread.

/// Instances of this service are looked for.
inline constexpr const char* kOscQueryService = "_oscjson._tcp.local";
/// What a VRChat's name begins with; other programs' do not.
inline constexpr std::string_view kVrChatName = "VRChat-Client";

/// A one-shot question of multicast DNS (RFC 6762, section 5.1).
///
/// name  in dots
/// type  ns_t_ptr, for the instances of a service, or ns_t_srv, for an instance's port
std::vector<std::uint8_t> mdns_question(const std::string& name, int type);

/// An instance of kOscQueryService that is a VRChat.
struct VrChatService {
  std::string name;        ///< "VRChat-Client-A1B2C3": letters, digits and "-" alone
  std::uint16_t port = 0;  ///< of its HTTP; 0: the answer does not say

  std::string full_name() const { return name + "." + kOscQueryService; }
};
inline constexpr std::size_t kMostServices = 16;
/// Of an answer of multicast DNS, 16 at most; none of what is no answer. Which machine a name belongs to is
/// not looked at: who answers is asked.
std::vector<VrChatService> parse_mdns_answer(std::span<const std::uint8_t> datagram);

/// What an answer over HTTP may have.
inline constexpr std::size_t kMostOscQueryBytes = 1U << 20;

/// Of "/?HOST_INFO".
struct OscHostInfo {
  std::string address;     ///< OSC_IP; empty: not told
  std::uint16_t port = 0;  ///< OSC_PORT
};
/// Throws Error(UnreadableInput) where it is none, or wants OSC over something else than UDP.
OscHostInfo parse_host_info(std::string_view text);

/// Of "/avatar/change": which avatar is worn; empty where that is not told. Throws Error(UnreadableInput).
std::string parse_avatar_change(std::string_view text);

struct AvatarParameter {
  std::string name;  ///< behind "/avatar/parameters/"
  char type = 'f';   ///< as OSC names it: f, i, T (a bool) ...

  bool operator==(const AvatarParameter&) const = default;
};
struct AvatarParameters {
  std::string avatar;  ///< as parse_avatar_change()
  std::vector<AvatarParameter> list;

  bool operator==(const AvatarParameters&) const = default;
};
inline constexpr std::size_t kMostAvatarParameters = 8192;
/// Of "/avatar": the parameters that may be set, 8192 at most. Throws Error(UnreadableInput).
AvatarParameters parse_avatar(std::string_view text);

}  // namespace facet::avatar
