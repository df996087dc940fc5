#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace facet::service {

/// An argument of an Open Sound Control message that a command may have; what else a message has is
/// monostate.
using OscValue = std::variant<std::monostate, std::int32_t, float, std::string, bool>;

struct OscMessage {
  std::string address;
  std::vector<OscValue> arguments;

  bool operator==(const OscMessage&) const = default;
};

/// Longest packet that is read or written.
inline constexpr std::size_t kMostOscBytes = 4096;

/// The messages of a packet from outside (OSC 1.0): one, or those of a bundle, whose times count as
/// "immediately". Nothing where it is not whole and sound: types beside i f s b h t d T F N I, texts that end
/// nowhere, more than 64 messages, 32 arguments or four bundles in one another.
std::optional<std::vector<OscMessage>> parse_osc(std::span<const std::byte> packet);

/// One message as a packet.
std::vector<std::byte> osc_packet(const OscMessage& message);

}  // namespace facet::service
