#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>

#include "avatar/bridge_target.hpp"
#include "avatar/vts_session.hpp"

namespace facet::avatar {

/// Permissions that VTube Studios gave, by target, in a JSON file that its owner alone reads (mode 0600):
/// "facet_vts": 1, "tokens" {target: token}. Any thread.
class VtsTokens {
 public:
  /// No file is no token. A file that can't be used is set aside; `fault` says so.
  explicit VtsTokens(std::filesystem::path file);
  ~VtsTokens();

  std::string of(const std::string& target) const;
  /// Writes the file; empty: none any more. Throws Error(Storage).
  void keep(const std::string& target, const std::string& token);
  const std::string& fault() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};
inline constexpr std::size_t kMostVtsTokensBytes = 1U << 16;

struct VtsLinkStatus {
  std::uint64_t frames = 0;  ///< sent
  std::uint64_t failed = 0;  ///< left out, for it was not ready for them or takes no more
  std::string reason;        ///< what is wrong or waited for; empty where all is well
};

/// After a connection that failed the next is tried so much later, twice as much each time up to the most.
struct VtsPatience {
  std::chrono::milliseconds least = std::chrono::seconds(1);
  std::chrono::milliseconds most = std::chrono::seconds(20);
  std::chrono::milliseconds answer = std::chrono::seconds(10);  ///< for one that no person is asked for
};

/// One VTube Studio's API for plug-ins, over its WebSocket, on a thread of its own, `facet-vts`. Connects
/// again by itself. Whoever hands frames over never waits: the newest one counts.
class VtsLink {
 public:
  /// tokens: outlives it. look_up: of the target's name; called on its thread.
  VtsLink(BridgeTarget target, VtsTokens& tokens, LookUp look_up, VtsPatience patience = {});
  ~VtsLink();
  VtsLink(const VtsLink&) = delete;
  VtsLink& operator=(const VtsLink&) = delete;

  void start();
  void request_stop();  ///< any thread
  void stop();
  /// False while a name is looked up: stop() waits for that. Any thread.
  bool finished() const;

  /// Any thread. Empty: there is no face, nothing is sent.
  void publish(std::shared_ptr<const VtsParameters> parameters);
  VtsLinkStatus status() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::avatar
