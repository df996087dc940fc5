#pragma once

#include <memory>

#include "service/config.hpp"
#include "service/log.hpp"

namespace facet::service {

/// The daemon: one pipeline, its stream, its takes and the control socket, from start to stop.
///
/// Threads, and what they may block on:
/// * main: signals, control socket, log, watchdog; begins and ends all others. Poll alone.
/// * `facet-open` opens source, model, tracker and GPU. Files, the driver.
/// * `facet-record` begins and ends takes. The disk.
/// * `facet-look` does what looking methods and the studio's files take. The disk.
/// * `facet-takes`, `facet-trim` rename, delete, note and cut takes. The disk.
/// * `facet-studio`, `facet-pictures`: see their classes. The disk.
/// * `facet-names` looks up the bridges' hosts. The resolver.
/// * `facet-vrchat` finds VRChats, where that is configured. Poll alone.
/// * `facet-vts`, for each of VTube Studio's APIs for plug-ins that is a target. It waits for that peer
/// alone.
/// * `facet-stream`, `facet-bridge`, `facet-take`, `facet-pack-N`, `facet-capture`, `facet-track`,
///   `facet-refine`: see their rooms.
///
/// SIGTERM, SIGINT and the control method "shutdown" end it within a second: takes are closed and sockets
/// removed; a frame that the GPU or a driver still holds then is abandoned with the process, and so is what a
/// disk does not take of a take. Only a take whose queue goes on to the disk is waited for, 8 s at most.
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
