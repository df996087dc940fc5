#pragma once

#include <memory>

#include "service/config.hpp"
#include "service/log.hpp"

namespace facet::service {

/// The daemon: one pipeline, its stream, its takes and the control socket, from start to stop.
///
/// | thread        | does                                                         | may block on   |
/// |---------------|--------------------------------------------------------------|----------------|
/// | main          | signals, control socket, log; begins and ends all others      | poll; the disk when a
/// take is closed | | `facet-open`  | opens source, model, tracker and GPU, so that main can answer | files,
/// the driver | | `facet-stream`, `facet-bridge`, `facet-take`, `facet-pack-N`, `facet-capture`,
/// `facet-track`, `facet-refine` | see their rooms | |
///
/// SIGTERM, SIGINT and the control method "shutdown" end it within a second in every state: takes are closed
/// and sockets removed; a frame that the GPU or a driver still holds then is abandoned with the process.
/// SIGHUP is logged and ignored: the configuration is read at the start alone.
///
/// A service manager (systemd) is told when source, model and GPU are open (READY), how the daemon does
/// (STATUS) and that it ends (STOPPING); its watchdog is fed as long as no thread of the pipeline hangs.
class Service {
 public:
  /// Binds the sockets, or takes those that the service manager passes. Throws Error(Storage) where a
  /// socket's path is taken or the takes' folder can't be written, Error(Usage) where a group does not exist.
  /// hold_signals() comes before. `log` outlives the service.
  Service(const Config& config, Log& log);
  ~Service();
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  /// Runs until stopped, or with Config::exit_at_end until the source ends or fails; without it the daemon
  /// stays and its status says what became of the source. Returns the process's exit status: 0, or the
  /// ErrorKind of what failed.
  int run();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Blocks the signals that a Service reads, which then wait for it, and ignores SIGPIPE. In the process's
/// only thread, as the first thing that it does.
void hold_signals();

/// Program and version, for people.
const char* software_name();

}  // namespace facet::service
