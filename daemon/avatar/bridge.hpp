#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "avatar/bridge_target.hpp"
#include "avatar/protocols.hpp"
#include "avatar/value_mapping.hpp"
#include "avatar/value_tuning.hpp"
#include "avatar/vrchat_finder.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::avatar {

struct BridgeConfig {
  std::vector<BridgeTarget> targets;  ///< none: nothing is sent
  double rate_hz = 60;                ///< at most so many frames a second are sent
  double smoothing_ms = 0;            ///< time constant; 0: none
  std::string subject = "facet";      ///< name in Live Link
  std::filesystem::path neutral_file = "/var/lib/facet/neutral.json";
  VmcShapes vmc_shapes = VmcShapes::PerfectSync;
  bool vmc_eye_bones = true;
  std::filesystem::path mapping_file;  ///< load_mapping(), until map() says otherwise; empty: none
  std::string answer;  ///< this machine's address at which requests are heard; empty: none are
  std::chrono::milliseconds look_up_every = std::chrono::seconds(30);          ///< names that were not found
  std::filesystem::path vts_tokens_file = "/var/lib/facet/vtube-studio.json";  ///< VtsTokens
  bool vts_arkit = false;   ///< ARKit's 52, too, as custom parameters of VTube Studio's
  VrChatFinderConfig find;  ///< VRChats that are targets without being configured
  ValueTunings values;      ///< where the mapping file has none, and until tune() says otherwise
};

struct BridgeTargetStatus {
  BridgeTarget target;
  bool asked = false;        ///< it is not configured, but asked (BridgeConfig::answer)
  std::uint64_t frames = 0;  ///< sent
  std::uint64_t failed = 0;  ///< of which a datagram could not be sent
  std::string
      reason{};        ///< of the last that failed; empty once 30 in a row went well, or once a name is found
  bool found = false;  ///< it is not configured, but a VRChat that was found (BridgeConfig::find)
  std::string name{};  ///< of a VRChat that answers: "VRChat-Client-A1B2C3"
  std::string avatar{};         ///< that it wears; empty: not known
  std::optional<int> driven{};  ///< of its avatar's parameters; none: which it has is not known, all are sent
};

/// Where the recording of the neutral pose stands.
enum class NeutralState { None, Recording, Set, Failed };
const char* to_string(NeutralState state);

struct BridgeStatus {
  std::vector<BridgeTargetStatus> targets;
  NeutralState neutral = NeutralState::None;
  std::string neutral_reason;  ///< why Failed; the earlier pose, if any, stays
  int neutral_frames = 0;      ///< recorded so far
  std::string tokens_reason;   ///< what was wrong with the file of VTube Studio's tokens at the start
  std::string answer_reason;   ///< why requests can't be heard now; it is tried again
  std::string find_reason;     ///< why VRChats can't be looked for now; it is tried again
  ValueTunings values;
};

/// What avatars are moved by. Knows the person's neutral pose and how far each value is followed, gives every
/// frame its MeshFrame::avatar_values by them, and sends those and the head to configured targets, of which
/// there may be none, over UDP, on the thread `facet-bridge`; to VTube Studio's API for plug-ins by threads
/// of their own (VtsLink). Whoever hands frames over never waits: the newest frame counts, and a datagram
/// that the network does not take at once is lost.
///
/// Who asks as receivers ask phones (PhoneRequests), where that is configured, is a target for as long as it
/// asked, unless its port is closed; 16 at most. Datagrams to such targets end at the first router, whoever
/// they said that they were.
///
/// VRChats that were found (VrChatFinder), where that is configured, are targets for as long as they answer,
/// 4 at most; datagrams to them end at the first router, too. Of each, as of a configured target that is one
/// of them, the parameters alone are sent that its avatar has, where it tells them.
class Bridge {
 public:
  /// Reads the neutral pose, where there is one, and the mapping file. Throws Error(UnreadableInput) where
  /// the former can't be used, Error(Usage) where the latter is wrong and Error(Internal) where no socket can
  /// be opened. Names of hosts are looked up now, which may take seconds. One that is not found is told in
  /// the target's reason and looked up again and again, beside the sending thread; until then it gets
  /// nothing.
  ///
  /// look_up  called by this and by a thread of the bridge's, `facet-names`; may block (see finished)
  explicit Bridge(const BridgeConfig& config, LookUp look_up = look_up_host);
  ~Bridge();
  Bridge(const Bridge&) = delete;
  Bridge& operator=(const Bridge&) = delete;

  void start();
  void request_stop();
  /// Idempotent; the destructor calls both.
  void stop();
  /// False while a name is looked up: the destructor waits for that. Any thread.
  bool finished() const;

  /// Sets frame.avatar_values; a neutral pose is recorded of these frames. In the frames' order, before
  /// publish(); any thread; takes a lock that is never held for long.
  void complete(mesh::MeshFrame& frame);
  /// False: complete() would leave the values empty and nothing is recorded. Any thread.
  bool changes_values() const;
  /// A completed frame, to be sent. Any thread; takes a lock that is never held for long.
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
  /// Sends these formulas in the place of those before from the next frame on; mapping.values is not looked
  /// at. Any thread.
  void map(const ValueMapping& mapping);
  /// What is sent now, its values those of the status. Any thread.
  ValueMapping mapping() const;
  /// ARKit's values as they were sent last. Any thread.
  mesh::ArkitValues sent_values() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::avatar
