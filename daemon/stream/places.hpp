#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "facet/clock.hpp"

namespace facet::stream {

/// Connections that a server accepts in one round of its loop: who connects and closes without end costs the
/// others a bounded part of each round.
inline constexpr int kAcceptsPerRound = 16;

struct PlacesConfig {
  std::size_t total = 64;
  std::size_t reserved = 0;  ///< of total, for those who may command
  /// Of one peer who may not command.
  std::size_t per_peer = 64;
  /// How long a place that was never used is safe from those who have no more right to it than its holder.
  /// Between two who may command it is not safe at all.
  std::chrono::milliseconds unused_keeps{1000};
  /// The same for a place that was used, since its last use.
  std::chrono::milliseconds idle_keeps{5000};
  /// Connects of one peer who may not command: so many at once, then so many a second. 0: any number.
  int connects_at_once = 0;
  int connects_per_s = 0;
};

/// Who asks for a place.
struct Visitor {
  std::string peer;  ///< those who share it share a limit: "uid 1000", an address
  bool may_command = false;
};

/// Who may have one of a server's places. Nobody can keep all of them from the others: some are for those who
/// may command, a peer has so many, and when there is none left the one that was idle for longest gives way.
/// Who may command takes the place of whoever may only look, and among his like one that is not in use.
///
/// Knows nothing of sockets: the server names connections by ids and closes what gives way. One thread.
class Places {
 public:
  using Id = std::uint64_t;

  enum class Answer { Admitted, NoPlace, TooManyOfPeer, TooManyConnects };
  struct Outcome {
    Answer answer = Answer::Admitted;
    std::optional<Id> gives_way;  ///< to be closed; it has lost its place already
  };

  explicit Places(const PlacesConfig& config);

  /// Asks for a place under an id that nobody has.
  Outcome enter(Id id, const Visitor& visitor, Clock::time_point now);
  /// The place is used: a request came whole, something was taken of what was sent. Unknown ids do nothing.
  void used(Id id, Clock::time_point now);
  /// Unknown ids do nothing.
  void leave(Id id);

  std::size_t size() const { return holders_.size(); }
  const PlacesConfig& config() const { return config_; }

 private:
  struct Holder {
    Visitor visitor;
    bool was_used = false;
    Clock::time_point last_use;  ///< or when it came
  };
  struct Connects {
    double left = 0;
    Clock::time_point counted;
  };
  using Holders = std::map<Id, Holder>;

  bool may_connect(const std::string& peer, Clock::time_point now);
  bool gives_way(const Holder& holder, const Visitor& visitor, Clock::time_point now) const;
  template <typename Allowed>
  Holders::iterator longest_idle(Allowed allowed);

  PlacesConfig config_;
  Holders holders_;
  std::map<std::string, Connects> connects_;  ///< peers who have not all of their connects left
};

/// For people.
const char* to_string(Places::Answer answer);

}  // namespace facet::stream
