#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "facet/clock.hpp"
#include "service/control_protocol.hpp"
#include "service/log.hpp"
#include "service/take_index.hpp"

namespace facet::service {

struct TakeDeskConfig {
  std::filesystem::path folder;          ///< of the takes
  std::uint64_t disk_reserve_bytes = 0;  ///< a trim ends while this much is still free
  std::string software;                  ///< for people: program and version
  std::function<std::string()>
      recorded;  ///< name of the take that is recorded, or ""; any thread, never waits
  std::function<std::string()> in_studio;  ///< of that which the studio has open; likewise
};

/// The takes' part of the control protocol: takes.* but for the list (docs/control-protocol.md). Takes are
/// renamed, deleted, brought back, noted and cut here, on two threads that wait for the disk, so that the
/// loop does not: `facet-takes`, and `facet-trim` for what takes long. What is recorded, open in the studio
/// or being trimmed is refused; but what the studio shows may be trimmed, which only reads it.
class TakeDesk {
 public:
  /// Borrows the index, which is told of what changes, and the log. Empties the bin of what is older than
  /// TakeBin::kKept, once started, and every hour.
  TakeDesk(TakeDeskConfig config, TakeIndex& index, const Log& log);
  ~TakeDesk();
  TakeDesk(const TakeDesk&) = delete;
  TakeDesk& operator=(const TakeDesk&) = delete;

  ControlMethods methods();
  /// Of the trim that is in work, or was the last: as `takes.trim` of the status; null before the first. Any
  /// thread, never waits.
  nlohmann::json trim_status() const;

  /// Throws what Errands::start throws.
  void start();
  /// With every round of the loop.
  void look_after(Clock::time_point now = Clock::now());
  void request_stop();    ///< first phase; any thread. A trim is broken off
  bool finished() const;  ///< both threads have ended
  void stop();            ///< second phase

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::service
