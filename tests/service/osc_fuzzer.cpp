#include <cstddef>
#include <cstdint>
#include <span>

#include "service/osc_message.hpp"

/// Any bytes are messages or none; what was read is written and read again as the same.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto messages = facet::service::parse_osc(std::as_bytes(std::span(data, size)));
  if (!messages) {
    return 0;
  }
  for (const facet::service::OscMessage& message : *messages) {
    const auto packet = facet::service::osc_packet(message);
    const auto again = facet::service::parse_osc(packet);
    // A float that is no number is unlike itself.
    const bool fits = packet.size() <= facet::service::kMostOscBytes;
    if (fits && (!again || again->size() != 1 || again->front().address != message.address ||
                 again->front().arguments.size() != message.arguments.size())) {
      __builtin_trap();
    }
  }
  return 0;
}
