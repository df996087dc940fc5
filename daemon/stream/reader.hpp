#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "facet/clock.hpp"
#include "stream/framing.hpp"
#include "stream/protocol.hpp"
#include "stream/ring_layout.h"
#include "stream/server.hpp"
#include "stream/unix_socket.hpp"
#include "stream/web_socket.hpp"

namespace facet::stream {

/// A message with its header, ready to be sent; shared by the readers that are in the middle of it.
struct Packet {
  std::vector<std::uint8_t> bytes;
};

/// A WebSocket in the place of the Unix socket's framing.
struct WebPeer {
  WebSocketAssembler requests{kMaxRequestBytes};
  WebSocketHeader header;            ///< of the message that goes out
  std::vector<std::uint8_t> answer;  ///< pong or close that is to be sent; empty: none
  bool answer_goes_out = false;      ///< outgoing is an answer, ready as it is
  Clock::time_point second;          ///< in which the requests are counted
  int requests_in_second = 0;
};

/// A connection of the server, with what it was sent so far. facet-stream only.
struct Reader {
  explicit Reader(FileDescriptor connection) : fd(std::move(connection)) {}

  FileDescriptor fd;
  MessageAssembler requests{kMaxRequestBytes};
  Subscription subscription;
  ReaderStatistics statistics;
  std::shared_ptr<const Packet> outgoing;  ///< null: ready for the next message
  std::size_t sent_bytes = 0;              ///< of outgoing
  bool outgoing_is_frame = false;
  bool hello_sent = false;
  bool waits_for_room = false;  ///< EPOLLOUT is armed
  bool gone = false;            ///< to be removed after this round
  Clock::time_point came = Clock::now();
  std::uint64_t subject_number = 0;  ///< of the one that the reader was sent in its profile; 0: none
  std::uint64_t albedo_version = 0;
  std::uint64_t last_number = 0;  ///< newest publication that was sent or counted as dropped
  std::uint64_t dropped_since_frame = 0;
  std::uint64_t dropped_told = 0;

  /// Wake-ups of a ring's reader. A pipe and no eventfd: both ends of an eventfd are one open file, whose
  /// O_NONBLOCK the reader could take away, and then fill it so that the next wake-up never returns.
  FileDescriptor wake;
  FileDescriptor wake_far_end;         ///< the reader's, kept so that nobody gets SIGPIPE
  std::vector<FileDescriptor> passed;  ///< go with the first byte of outgoing
  std::uint64_t ring_generation = 0;   ///< of the ring that was offered last; 0: none
  int ring_offers = 0;

  std::optional<WebPeer> web;  ///< none: a Unix socket

  /// Frames come through a ring. Pictures never do.
  bool by_ring() const {
    return !web && statistics.subscribed && subscription.ring_version >= FACET_RING_VERSION &&
           !subscription.want_images;
  }

  /// The message that is sent next, where none is on its way.
  void set_outgoing(std::shared_ptr<const Packet> message);
  /// Sends what the socket takes of the outgoing message. Returns true once it is all sent.
  bool send_outgoing();
  /// Ends a WebSocket. In the middle of a message there is no way to say why.
  void close_web(WebSocketClose code, const std::string& why);
};

}  // namespace facet::stream
