#pragma once

#include <sys/socket.h>

#include <chrono>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "facet/clock.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket.hpp"

namespace facet::stream {

/// What a server's answer to a WebSocket's opening request says against it; empty where it takes it (RFC
/// 6455, section 4.1).
///
/// head  of the answer, with the empty line at its end
/// key   the request's Sec-WebSocket-Key
std::string web_socket_refusal(std::string_view head, std::string_view key);

/// Makes an eventfd readable; and waits until it is, or for a while, and takes that back. Any thread.
void signal_event(int event);
void wait_for_event(int event, Clock::duration most);

/// A WebSocket (RFC 6455) to somebody else's server, "/", without TLS and extensions; texts both ways. Never
/// waits but in wait(). One thread.
class WebSocketClient {
 public:
  /// host: "HOST:PORT", for the request. limit_bytes: of one message that comes.
  WebSocketClient(std::string host, std::size_t limit_bytes);

  /// Begins. Returns what the system said, or empty.
  std::string connect(const sockaddr* address, socklen_t length);
  /// Until something can be read, or written where that waits, or an eventfd is readable, which is taken
  /// back.
  void wait(int event, Clock::duration most) const;
  /// Reads and writes what there is. Returns why the connection is over, or empty.
  std::string work();
  /// The server has agreed.
  bool is_open() const { return is_open_; }
  /// All that was to be sent is with the kernel.
  bool is_idle() const { return out_.empty(); }

  /// Sent by work().
  void send(std::string_view text);
  /// The next message that came.
  std::optional<std::string> next();

 private:
  void send(WebSocketOpcode opcode, std::string_view payload);
  std::string write();
  std::string take(std::span<const std::uint8_t> bytes);

  std::string host_;
  std::string key_;
  FileDescriptor socket_;
  bool is_open_ = false;
  std::string head_;  ///< of the server's answer, so far
  std::vector<std::uint8_t> out_;
  WebSocketAssembler assembler_;
  std::deque<std::string> messages_;
};

}  // namespace facet::stream
