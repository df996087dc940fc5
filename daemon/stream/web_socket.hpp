#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

/// The framing of the WebSocket protocol (RFC 6455), without extensions: what comes over a connection whose
/// HTTP request is done with already.
namespace facet::stream {

enum class WebSocketOpcode : std::uint8_t {
  Continuation = 0,
  Text = 1,
  Binary = 2,
  Close = 8,
  Ping = 9,
  Pong = 10
};

/// Why a connection is closed (RFC 6455, section 7.4.1); 4000 and above are ours.
enum class WebSocketClose : std::uint16_t {
  GoingAway = 1001,
  Violation = 1002,
  Refused = 1008,
  TooLong = 1009,
  WrongToken = 4403,
  TooManyTokens = 4429,
};

/// The value of Sec-WebSocket-Accept for a Sec-WebSocket-Key (section 4.2.2).
std::string web_socket_accept(std::string_view key);

/// Head of an unfragmented, unmasked frame; view() is what to send before `length` bytes.
struct WebSocketHeader {
  WebSocketHeader() = default;
  WebSocketHeader(WebSocketOpcode opcode, std::size_t length);
  std::span<const std::uint8_t> view() const { return std::span(bytes).first(size); }

  std::array<std::uint8_t, 10> bytes{};
  std::size_t size = 0;
};

/// A whole control frame; what is longer than 125 bytes is cut.
std::vector<std::uint8_t> web_socket_pong(std::span<const std::uint8_t> payload);
std::vector<std::uint8_t> web_socket_close(WebSocketClose code, std::string_view reason);

/// Who speaks: a client's frames are masked, a server's are not.
enum class WebSocketPeer { Client, Server };

/// Puts a peer's messages together from the pieces that a socket delivers. One thread.
class WebSocketAssembler {
 public:
  enum class Outcome {
    Incomplete,  ///< all bytes were taken; more are needed
    Message,     ///< message() is whole; call next() before more bytes
    Ping,        ///< control() is to be sent back
    Close,       ///< the peer says that it is done
    Violation,   ///< not the protocol, or an extension that nobody offered; nothing more can be read
    TooLong,     ///< a message beyond the limit; nothing more can be read
  };

  /// limit_bytes: of one message, all its fragments. Memory grows with what has come, not with what is
  /// announced.
  explicit WebSocketAssembler(std::size_t limit_bytes, WebSocketPeer peer = WebSocketPeer::Client)
      : limit_bytes_(limit_bytes), mask_bytes_(peer == WebSocketPeer::Client ? 4 : 0) {}

  /// Takes bytes up to the end of the current frame; `bytes` is advanced past what was taken. Pongs are
  /// passed over.
  Outcome feed(std::span<const std::uint8_t>& bytes);

  /// Valid until next().
  std::span<const std::uint8_t> message() const { return message_; }
  bool is_text() const { return opcode_ == WebSocketOpcode::Text; }
  void next();
  /// Of the last ping, 0 to 125 bytes.
  std::span<const std::uint8_t> control() const { return control_; }

 private:
  bool read_head();
  Outcome end_of_frame();

  std::size_t limit_bytes_;
  std::size_t mask_bytes_;
  std::vector<std::uint8_t> message_;
  std::vector<std::uint8_t> control_;
  WebSocketOpcode opcode_ = WebSocketOpcode::Continuation;  ///< of the message; Continuation: none has begun
  bool whole_ = false;                                      ///< message_ waits for next()

  // Of the frame that is being read.
  std::array<std::uint8_t, 14> head_{};
  std::size_t head_filled_ = 0;
  std::size_t head_size_ = 2;  ///< as far as is known
  bool in_payload_ = false;
  bool last_ = false;
  WebSocketOpcode frame_ = WebSocketOpcode::Continuation;
  std::uint64_t length_ = 0;
  std::uint64_t taken_ = 0;
  std::array<std::uint8_t, 4> mask_{};  ///< zeros where there is none
};

/// The address at the other end of a TCP connection, as places are counted by it: without its port, IPv6 only
/// its network of 64 bits, of which one machine has all. Empty where there is none.
std::string peer_address(int connection);

}  // namespace facet::stream
