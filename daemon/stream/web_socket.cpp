#include "stream/web_socket.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "facet/assert.hpp"
#include "stream/base64.hpp"

namespace facet::stream {
namespace {

constexpr std::size_t kMostControlBytes = 125;

/// SHA-1 (RFC 3174), which the handshake asks for; it protects nothing there.
std::array<std::uint8_t, 20> sha1(std::string_view text) {
  std::vector<std::uint8_t> padded(text.begin(), text.end());
  padded.push_back(0x80);
  padded.resize((padded.size() + 8 + 63) / 64 * 64);
  const std::uint64_t bits = std::uint64_t{text.size()} * 8;
  for (std::size_t byte = 0; byte < 8; ++byte) {
    padded[padded.size() - 1 - byte] = static_cast<std::uint8_t>(bits >> (8 * byte));
  }
  std::array<std::uint32_t, 5> hash{0x67452301, 0xEFCDAB89, 0x98BADCFE, 0x10325476, 0xC3D2E1F0};
  for (std::size_t block = 0; block < padded.size(); block += 64) {
    std::array<std::uint32_t, 80> words{};
    for (std::size_t i = 0; i < 64; ++i) {
      words.at(i / 4) |= static_cast<std::uint32_t>(padded[block + i]) << (24 - 8 * (i % 4));
    }
    for (std::size_t t = 16; t < 80; ++t) {
      words.at(t) = std::rotl(words.at(t - 3) ^ words.at(t - 8) ^ words.at(t - 14) ^ words.at(t - 16), 1);
    }
    auto [a, b, c, d, e] = hash;
    for (std::size_t t = 0; t < 80; ++t) {
      const std::uint32_t mixed = t < 20   ? ((b & c) | (~b & d)) + 0x5A827999
                                  : t < 40 ? (b ^ c ^ d) + 0x6ED9EBA1
                                  : t < 60 ? ((b & c) | (b & d) | (c & d)) + 0x8F1BBCDC
                                           : (b ^ c ^ d) + 0xCA62C1D6;
      const std::uint32_t next = std::rotl(a, 5) + mixed + e + words.at(t);
      e = d;
      d = c;
      c = std::rotl(b, 30);
      b = a;
      a = next;
    }
    hash = {hash[0] + a, hash[1] + b, hash[2] + c, hash[3] + d, hash[4] + e};
  }
  std::array<std::uint8_t, 20> digest{};
  for (std::size_t i = 0; i < digest.size(); ++i) {
    digest.at(i) = static_cast<std::uint8_t>(hash.at(i / 4) >> (24 - 8 * (i % 4)));
  }
  return digest;
}

std::vector<std::uint8_t> control_frame(WebSocketOpcode opcode, std::span<const std::uint8_t> payload) {
  payload = payload.first(std::min(payload.size(), kMostControlBytes));
  const WebSocketHeader header(opcode, payload.size());
  std::vector<std::uint8_t> frame(header.view().begin(), header.view().end());
  frame.insert(frame.end(), payload.begin(), payload.end());
  return frame;
}

bool is_control(WebSocketOpcode opcode) {
  return opcode >= WebSocketOpcode::Close;
}

}  // namespace

std::string web_socket_accept(std::string_view key) {
  return base64(sha1(std::string(key) + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"));
}

WebSocketHeader::WebSocketHeader(WebSocketOpcode opcode, std::size_t length) {
  bytes[0] = static_cast<std::uint8_t>(0x80U | static_cast<unsigned>(opcode));
  const std::size_t extra = length < 126 ? 0 : length < 65536 ? 2 : 8;
  bytes[1] = static_cast<std::uint8_t>(extra == 0 ? length : extra == 2 ? 126 : 127);
  for (std::size_t byte = 0; byte < extra; ++byte) {
    bytes.at(2 + byte) = static_cast<std::uint8_t>(length >> (8 * (extra - 1 - byte)));
  }
  size = 2 + extra;
}

std::vector<std::uint8_t> web_socket_pong(std::span<const std::uint8_t> payload) {
  return control_frame(WebSocketOpcode::Pong, payload);
}

std::vector<std::uint8_t> web_socket_close(WebSocketClose code, std::string_view reason) {
  const auto number = static_cast<std::uint16_t>(code);
  std::vector<std::uint8_t> payload{static_cast<std::uint8_t>(number >> 8U),
                                    static_cast<std::uint8_t>(number & 0xFFU)};
  payload.insert(payload.end(), reason.begin(), reason.end());
  return control_frame(WebSocketOpcode::Close, payload);
}

/// Reads what the bytes in head_ say. False where the protocol forbids it.
bool WebSocketAssembler::read_head() {
  if (head_filled_ == 2 && head_size_ == 2) {
    const unsigned short_length = head_[1] & 0x7FU;
    const bool masked = (head_[1] & 0x80U) != 0;
    const bool reserved = (head_[0] & 0x70U) != 0;
    last_ = (head_[0] & 0x80U) != 0;
    frame_ = static_cast<WebSocketOpcode>(head_[0] & 0x0FU);
    const bool known = frame_ <= WebSocketOpcode::Binary ||
                       (frame_ >= WebSocketOpcode::Close && frame_ <= WebSocketOpcode::Pong);
    const bool continues = frame_ == WebSocketOpcode::Continuation;
    const bool fits = is_control(frame_) ? last_ && short_length <= kMostControlBytes
                                         : continues == (opcode_ != WebSocketOpcode::Continuation);
    if (reserved || masked != (mask_bytes_ > 0) || !known || !fits) {
      return false;
    }
    head_size_ = 2 + (short_length == 126 ? 2U : short_length == 127 ? 8U : 0U) + mask_bytes_;
  }
  if (head_filled_ == head_size_) {
    const std::size_t extra = head_size_ - 2 - mask_bytes_;
    length_ = extra == 0 ? head_[1] & 0x7FU : 0;
    for (std::size_t byte = 0; byte < extra; ++byte) {
      length_ = length_ << 8U | head_.at(2 + byte);
    }
    std::copy_n(head_.begin() + static_cast<std::ptrdiff_t>(2 + extra), mask_bytes_, mask_.begin());
    taken_ = 0;
    in_payload_ = true;
    if (is_control(frame_)) {
      control_.clear();
    } else if (frame_ != WebSocketOpcode::Continuation) {
      opcode_ = frame_;
    }
  }
  return true;
}

WebSocketAssembler::Outcome WebSocketAssembler::end_of_frame() {
  head_filled_ = 0;
  head_size_ = 2;
  in_payload_ = false;
  switch (frame_) {
    case WebSocketOpcode::Close:
      return Outcome::Close;
    case WebSocketOpcode::Ping:
      return Outcome::Ping;
    case WebSocketOpcode::Pong:
      return Outcome::Incomplete;
    default:
      whole_ = last_;
      return last_ ? Outcome::Message : Outcome::Incomplete;
  }
}

WebSocketAssembler::Outcome WebSocketAssembler::feed(std::span<const std::uint8_t>& bytes) {
  while (!whole_) {
    while (!in_payload_) {
      if (bytes.empty()) {
        return Outcome::Incomplete;
      }
      head_.at(head_filled_++) = bytes.front();
      bytes = bytes.subspan(1);
      if (!read_head()) {
        return Outcome::Violation;
      }
    }
    std::vector<std::uint8_t>& out = is_control(frame_) ? control_ : message_;
    if (!is_control(frame_) && length_ > limit_bytes_ - message_.size() + taken_) {
      return Outcome::TooLong;
    }
    const std::size_t count = std::min<std::uint64_t>(bytes.size(), length_ - taken_);
    for (std::size_t i = 0; i < count; ++i) {
      out.push_back(bytes[i] ^ mask_.at((taken_ + i) % mask_.size()));
    }
    taken_ += count;
    bytes = bytes.subspan(count);
    FACET_ASSERT(taken_ <= length_ && message_.size() <= limit_bytes_, taken_, length_, message_.size());
    if (taken_ < length_) {
      return Outcome::Incomplete;
    }
    if (const Outcome outcome = end_of_frame(); outcome != Outcome::Incomplete) {
      return outcome;
    }
  }
  return Outcome::Message;
}

void WebSocketAssembler::next() {
  message_.clear();
  opcode_ = WebSocketOpcode::Continuation;
  whole_ = false;
}

std::string peer_address(int connection) {
  sockaddr_storage address{};
  socklen_t size = sizeof(address);
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (::getpeername(connection, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    return {};
  }
  if (address.ss_family == AF_INET) {
    const auto& four = reinterpret_cast<const sockaddr_in&>(address);
    ::inet_ntop(AF_INET, &four.sin_addr, text.data(), text.size());
  } else if (address.ss_family == AF_INET6) {
    in6_addr six = reinterpret_cast<const sockaddr_in6&>(address).sin6_addr;
    if (!IN6_IS_ADDR_V4MAPPED(&six) && !IN6_IS_ADDR_LOOPBACK(&six)) {
      std::memset(&six.s6_addr[8], 0, 8);
    }
    ::inet_ntop(AF_INET6, &six, text.data(), text.size());
  }
  return text.data();
}

}  // namespace facet::stream
