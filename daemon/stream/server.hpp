#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "mesh/mesh_frame.hpp"
#include "stream/protocol.hpp"
#include "stream/unix_socket.hpp"

namespace facet::stream {

struct StreamServerConfig {
  std::filesystem::path socket;
  SocketAccess access;
  int max_readers = 64;     ///< places for them; docs/stream-protocol.md says who gets one
  int max_web_readers = 0;  ///< the same for those that come by adopt
  std::string server_name;  ///< for people, in Hello: program and version
};

struct ReaderStatistics {
  std::uint64_t id = 0;  ///< counts connections
  std::string client;    ///< as the client calls itself
  std::int32_t pid = 0;
  std::uint32_t uid = 0;
  Profile profile = Profile::Displacements;
  bool subscribed = false;
  bool ring = false;              ///< frames go through shared memory
  bool web = false;               ///< over a WebSocket; pid and uid are not known then
  std::uint64_t frames_sent = 0;  ///< ring: announced to a reader that had seen the announcement before
  std::uint64_t frames_dropped = 0;
  std::uint64_t bytes_sent = 0;
};

struct StreamStatistics {
  std::uint64_t published = 0;  ///< frames
  std::uint64_t skipped = 0;    ///< frames that were replaced before the stream thread saw them
  std::uint64_t connections = 0;
  std::uint64_t rounds = 0;  ///< of the stream's thread
  /// Connections closed for a wrong or oversized request, for want of a place, or because they gave way.
  std::uint64_t refused = 0;
  std::string last_refusal;         ///< for people; also why there was no ring
  std::uint64_t encoded_bytes = 0;  ///< frame messages, each profile counted once
  std::string failure;              ///< empty; else why the stream thread ended early
  std::vector<ReaderStatistics> readers;
};

/// Hands the newest frame to every reader over a Unix stream socket. A reader slower than the frames loses
/// whole frames, the newest wins, and is told how many (message Dropped); it never slows the pipeline or
/// another reader. A reader that joins late first gets the current subject and albedo. Readers that ask for
/// it get frames through shared memory (ring.hpp), one ring per profile, which stays until the server ends.
///
/// A reader has a place (places.hpp) as long as it takes what is sent; one that does not gives way to others,
/// and one that never subscribes is closed.
///
/// Life: construct (binds the socket, may throw Error) -> start -> publish ... -> request_stop -> stop ->
/// destroy. start begins the one thread `facet-stream`, which owns all connections and all encoding and
/// blocks only in epoll; stop joins it. Memory: one encoded frame per profile in use, one more for every
/// reader in the middle of an older one, kRingSlots frames and a quarter per profile with a ring.
class StreamServer {
 public:
  /// passed: a socket that the service manager listens on, see ListeningSocket.
  explicit StreamServer(const StreamServerConfig& config, FileDescriptor passed = {});
  ~StreamServer();
  StreamServer(const StreamServer&) = delete;
  StreamServer& operator=(const StreamServer&) = delete;

  void start();

  /// Makes `frame` the newest. Any thread; real-time safe: swaps a pointer under a lock that is never held
  /// across a system call or an encoding, and writes an eventfd. No effect after request_stop.
  void publish(std::shared_ptr<const mesh::MeshFrame> frame);

  /// Takes over a TCP connection whose WebSocket handshake is done: the same messages as binary messages,
  /// without the socket's header, and no ring. `early`: what has come of the client's bytes already. Any
  /// thread. A connection without a place is told so and closed, as is one after request_stop without a word.
  void adopt(FileDescriptor connection, std::vector<std::uint8_t> early);

  /// First phase of stopping: readers get Goodbye, nothing new is sent. Any thread, returns at once;
  /// idempotent.
  void request_stop();
  /// Second phase: waits for the thread (100 ms at most for the farewells) and removes the socket that was
  /// bound here.
  /// Idempotent; the destructor calls both.
  void stop();

  StreamStatistics statistics() const;  ///< any thread
  const std::filesystem::path& socket() const;

  /// A reader that asks for nothing for so long is closed.
  static constexpr std::chrono::seconds kSubscribeTime{5};
  /// File descriptors that a reader of the socket takes at most: itself, both ends of its wake-ups, and two
  /// on their way to it.
  static constexpr int kDescriptorsPerReader = 5;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::stream
