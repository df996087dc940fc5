#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "stream/decoder.hpp"
#include "stream/protocol.hpp"

namespace facet::stream {

enum class ReceiveOutcome {
  Received,  ///< a frame is in `out`
  Timeout,   ///< none within the time given; call again
  Closed,    ///< the server said goodbye or is gone; closed_reason() says which
};

/// Reads a stream in C++: connects, subscribes, keeps subject and albedo current, hands out frames. One
/// thread.
///
/// With Subscription::ring_version = FACET_RING_VERSION frames are read out of shared memory where the server
/// offers it (by_ring), and come as messages where not. Through a ring, a frame may be there before the
/// albedo that it refers to: DecodedFrame's is null until then.
class StreamClient {
 public:
  /// Connects and subscribes. Throws Error(Unavailable) where nobody answers within `timeout`,
  /// Error(UnreadableInput) where the server speaks another protocol.
  StreamClient(const std::filesystem::path& socket, const Subscription& subscription,
               std::chrono::milliseconds timeout = std::chrono::seconds(5));
  ~StreamClient();
  StreamClient(const StreamClient&) = delete;
  StreamClient& operator=(const StreamClient&) = delete;

  /// Waits for the next frame. Throws Error(UnreadableInput) where the server sends what the protocol does
  /// not allow; the connection is of no use then.
  ReceiveOutcome next(DecodedFrame& out, std::chrono::milliseconds timeout);

  const Hello& hello() const;
  /// The newest subject and albedo that were sent; null before the first.
  std::shared_ptr<const mesh::Subject> subject() const;
  std::shared_ptr<const mesh::Albedo> albedo() const;
  std::uint64_t dropped() const;  ///< frames lost since connecting, as the server told or their numbers say
  bool by_ring() const;           ///< frames come through shared memory
  /// Frames that were overwritten while they were read, and thrown away.
  std::uint64_t overwritten() const;
  std::uint64_t bytes_received() const;
  const std::string& closed_reason() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::stream
