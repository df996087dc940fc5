#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace facet::stream {

/// Base 64 with padding (RFC 4648, section 4). Any thread.
std::string base64(std::span<const std::uint8_t> bytes);

}  // namespace facet::stream
