#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <thread>

#include "facet/mutex.hpp"
#include "pipeline/shading_config.hpp"
#include "trigger/lines.hpp"

namespace facet::pipeline {

/// One lamp after the other, then none, for one burst; all are off between bursts and after the end. By the
/// pictures' time, from picture to picture: they need not be exposed in step. Where no picture comes for a
/// burst's end, a thread, `facet-lamps`, puts them out a second later. One thread, but for that.
class LampBurst {
 public:
  /// lines  at rest; count: how many
  LampBurst(std::unique_ptr<trigger::TriggerLines> lines, int count, int each_ms);
  ~LampBurst();
  LampBurst(const LampBurst&) = delete;
  LampBurst& operator=(const LampBurst&) = delete;

  int count() const { return count_; }
  double duration_s() const { return static_cast<double>(count_ + 1) * static_cast<double>(each_ns_) * 1e-9; }

  /// The first lamp goes on. now_ns: media time of the newest picture
  void begin(std::int64_t now_ns);
  /// Switches what is due. False: it is over.
  bool go_on(std::int64_t now_ns);
  /// All go off.
  void end();

  bool is_on() const;
  /// Why a burst was ended before its time, or the lamps could not be put out; else empty.
  std::string fault() const;

 private:
  void show(int step) FACET_REQUIRES(mutex_);
  void put_out() FACET_REQUIRES(mutex_);
  void watch();

  int count_;
  std::int64_t each_ns_;
  std::int64_t began_ns_ = 0;
  mutable Mutex mutex_;
  Condition ended_;
  std::unique_ptr<trigger::TriggerLines> lines_ FACET_GUARDED_BY(mutex_);
  int step_ FACET_GUARDED_BY(mutex_) = -1;  ///< which lamp is on; count_: none, as the room is; -1: no burst
  std::string fault_ FACET_GUARDED_BY(mutex_);
  std::jthread watcher_;  ///< of the last burst
};

/// Takes the lines and puts the lamps out. Null where there are none. Throws Error(Unavailable) naming chip,
/// line and who holds it.
std::unique_ptr<LampBurst> open_lamps(const LampsConfig& config);

}  // namespace facet::pipeline
