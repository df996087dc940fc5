#pragma once

#include <chrono>
#include <optional>
#include <string>

#include "facet/clock.hpp"
#include "pipeline/progress.hpp"
#include "service/log.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {

/// Sockets that the service manager has bound and passes on (LISTEN_FDS); empty where it passes none.
struct PassedSockets {
  stream::FileDescriptor stream;
  stream::FileDescriptor control;
};

/// Takes what the service manager passes, by name: "stream" and "control" (FileDescriptorName= of the socket
/// units). Once, before there is another thread: it changes the environment. Throws Error(Usage) for a
/// descriptor of another name.
PassedSockets take_passed_sockets();

/// What the daemon tells its service manager (sd_notify(3)) and when it asks for its watchdog to be fed.
/// Without a service manager nothing is sent. One thread, which must be the daemon's loop; blocks where the
/// service manager has stopped reading.
class ServiceManager {
 public:
  /// Reads NOTIFY_SOCKET and WATCHDOG_USEC. `log` outlives this object.
  explicit ServiceManager(const Log& log);

  /// Start-up is over: source, model and GPU are open.
  void ready();
  /// One line for people (`systemctl status`); sent where it differs from the last one.
  void status(const std::string& text);
  void stopping();

  /// To be called with every round of the loop, with the pipeline's longest silence (none: no thread of it is
  /// at work, so that the loop's own round is progress enough). Feeds the watchdog unless that silence is
  /// longer than patience(), and lets it bite once the silence is as long as the watchdog's time; logs once
  /// when a thread falls silent, and when it gets on again.
  void look_after(const std::optional<pipeline::Progress::Silence>& silence);

  /// A thread silent for longer is hung: half the watchdog's time, 10 s where there is no watchdog.
  std::chrono::microseconds patience() const;

 private:
  const Log& log_;
  std::optional<std::chrono::microseconds> watchdog_;  ///< kills after this time without food
  Clock::time_point fed_;
  bool hung_ = false;
  bool triggered_ = false;
  std::string status_;
};

}  // namespace facet::service
