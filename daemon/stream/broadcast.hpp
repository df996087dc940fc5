#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "facet/clock.hpp"
#include "mesh/mesh_frame.hpp"
#include "stream/encoder.hpp"
#include "stream/protocol.hpp"
#include "stream/reader.hpp"
#include "stream/ring.hpp"
#include "stream/server.hpp"

namespace facet::stream {

/// What readers are sent: the newest frame, and the subject and albedo that it needs, each made once for all
/// readers of a profile, as messages and in rings. facet-stream only.
class Broadcast {
 public:
  /// The server's part in it.
  struct Calls {
    std::function<void(const Reader&)> used;  ///< the reader has taken something
    std::function<void(Reader&, const std::string& why)> refuse;
  };

  /// server: for people, in Hello. `statistics` is the server's, and outlives this object.
  Broadcast(const std::string& server, StreamStatistics& statistics, Calls calls);

  /// Makes `frame` the current one. number: publications up to and with it.
  void take(std::shared_ptr<const mesh::MeshFrame> frame, std::uint64_t number);
  std::uint64_t current_number() const { return current_number_; }

  std::shared_ptr<const Packet> goodbye(const std::string& why);
  /// What this reader needs next: hello, then subject, albedo and drop notice before the frame that needs
  /// them.
  std::shared_ptr<const Packet> next_packet(Reader& reader);
  /// Rings come before sockets: their readers want the least delay.
  void announce(const std::vector<std::unique_ptr<Reader>>& readers);

 private:
  /// The ring of one profile, made when it is first asked for.
  struct Ring {
    std::optional<RingWriter> writer;
    std::uint64_t generation = 0;  ///< another one for every ring of the server
    std::uint64_t number = 0;      ///< of the newest frame in it
  };

  /// A free packet of the pool, or one more: the pool is bounded by the packets in use, one per reader and
  /// those kept below.
  std::shared_ptr<const Packet> packet(std::span<const std::uint8_t> message);
  std::shared_ptr<const Packet> frame_packet(const Subscription& subscription);
  /// Puts the current frame into the ring of a profile; into a new, larger ring where it does not fit. False
  /// where none is to be had.
  bool fill_ring(Profile profile);
  /// Wakes a ring's reader for the current frame. One that has not seen the last wake-up has lost that frame.
  void announce(Reader& reader);
  /// The offer of a ring that the reader does not have yet; else null.
  std::shared_ptr<const Packet> ring_packet(Reader& reader);

  StreamStatistics& statistics_;
  Calls calls_;
  Encoder encoder_;
  std::vector<std::shared_ptr<Packet>> pool_;
  std::shared_ptr<const Packet> hello_;
  std::shared_ptr<const mesh::MeshFrame> current_;
  std::uint64_t current_number_ = 0;              ///< publications up to and with current_
  std::shared_ptr<const mesh::Subject> subject_;  ///< of the newest frame that had one
  /// What readers know it by: one more with every subject, and from another start on in every server, so
  /// that a reader that connects anew never takes one subject for another.
  std::uint64_t subject_number_ = static_cast<std::uint64_t>(Clock::now_ns());
  std::shared_ptr<const mesh::Albedo> albedo_;  ///< likewise, of that subject
  /// A frame's message as somebody wants it.
  struct FramePacket {
    Profile profile;
    WantedPixels pixels;
    std::shared_ptr<const Packet> packet;
  };
  std::vector<FramePacket> frame_packets_;  ///< of current_, made when asked for
  std::array<std::shared_ptr<const Packet>, kProfileCount> subject_packets_;  ///< of subject_
  std::shared_ptr<const Packet> albedo_packet_;                               ///< of albedo_
  std::array<Ring, kProfileCount> rings_;
  std::uint64_t ring_generations_ = 0;
};

}  // namespace facet::stream
