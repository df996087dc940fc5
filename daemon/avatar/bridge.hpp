#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "avatar/value_tuning.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::avatar {

enum class BridgeProtocol { Vmc, LiveLinkFace };
/// As the configuration names it.
const char* to_string(BridgeProtocol protocol);

/// Where a bridge sends to.
struct BridgeTarget {
  BridgeProtocol protocol = BridgeProtocol::Vmc;
  std::string address;  ///< IPv4 or IPv6 in digits, or the name of a host
  std::uint16_t port = 0;

  std::string text() const;  ///< "ADDRESS:PORT", "[ADDRESS]:PORT" for IPv6
};

/// Reads "ADDRESS:PORT", "[ADDRESS]:PORT" or "HOST:PORT"; nothing where it is none. No name is looked up.
std::optional<BridgeTarget> parse_target(BridgeProtocol protocol, const std::string& text);

struct BridgeConfig {
  std::vector<BridgeTarget> targets;  ///< none: the bridge is off
  double rate_hz = 60;                ///< at most so many frames a second are sent
  double smoothing_ms = 0;            ///< time constant; 0: none
  std::string subject = "facet";      ///< name in Live Link
  std::filesystem::path neutral_file = "/var/lib/facet/neutral.json";
  ValueTunings values;  ///< until tune() says otherwise
};

struct BridgeTargetStatus {
  BridgeTarget target;
  std::uint64_t frames = 0;  ///< sent
  std::uint64_t failed = 0;  ///< of which a datagram could not be sent
  std::string reason;        ///< of the last that failed; empty once 30 in a row went well
};

/// Where the recording of the neutral pose stands.
enum class NeutralState { None, Recording, Set, Failed };
const char* to_string(NeutralState state);

struct BridgeStatus {
  std::vector<BridgeTargetStatus> targets;
  NeutralState neutral = NeutralState::None;
  std::string neutral_reason;  ///< why Failed; the earlier pose, if any, stays
  int neutral_frames = 0;      ///< recorded so far
  ValueTunings values;
};

/// Sends every frame's expression and head to configured targets over UDP, on the thread `facet-bridge`.
/// Whoever hands frames over never waits: the newest frame counts, and a datagram that the network does not
/// take at once is lost.
class Bridge {
 public:
  /// Reads the neutral pose, where there is one. Throws Error(UnreadableInput) where its file can't be used
  /// and Error(Internal) where no socket can be opened. Names of hosts are looked up now and not again, which
  /// may take seconds; one that is not found is told in the target's reason, and nothing is sent to it.
  explicit Bridge(const BridgeConfig& config);
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  void start();
  void request_stop();
  /// Idempotent; the destructor calls both.
  void stop();

  /// Any thread; takes a lock that is held for copying a pointer.
  void publish(std::shared_ptr<const mesh::MeshFrame> frame);
  BridgeStatus status() const;

  /// Records the neutral pose from the frames of the next while, takes it into use and writes it to its file.
  /// Any thread. Throws Error(Usage) while one is being recorded.
  void record_neutral(std::chrono::milliseconds duration);
  /// Forgets the neutral pose and removes its file. Any thread. Throws Error(Storage) where it can't.
  void clear_neutral();
  /// Takes these in the place of the configured ones from the next frame on, until the bridge ends. Any
  /// thread.
  void tune(const ValueTunings& values);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::avatar
