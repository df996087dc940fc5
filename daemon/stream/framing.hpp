#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/protocol.hpp"

namespace facet::stream {

/// The socket's header for a message of `length` bytes.
std::array<std::uint8_t, kHeaderBytes> make_header(std::size_t length);

/// Puts messages together from the pieces that a socket delivers. One thread.
class MessageAssembler {
 public:
  enum class Outcome {
    Incomplete,  ///< more bytes are needed
    Complete,    ///< message() is whole; call next() before more bytes
    WrongMagic,  ///< the peer does not speak the protocol; nothing more can be read
    TooLong,     ///< the peer announces more than the limit; nothing more can be read
  };

  /// limit_bytes: of one message without header. Memory grows to the longest message seen, not to the limit:
  /// a header alone allocates nothing.
  explicit MessageAssembler(std::size_t limit_bytes) : limit_bytes_(limit_bytes) {}

  /// Takes bytes up to the end of the current message; `bytes` is advanced past what was taken.
  Outcome feed(std::span<const std::uint8_t>& bytes);

  /// The whole message, without header; valid until next().
  std::span<const std::uint8_t> message() const { return message_; }
  void next();

 private:
  std::size_t limit_bytes_;
  std::array<std::uint8_t, kHeaderBytes> header_{};
  std::size_t header_filled_ = 0;
  std::size_t length_ = 0;
  std::vector<std::uint8_t> message_;
};

}  // namespace facet::stream
