#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "trigger/gpio_trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::pipeline {

/// Lamps of a kiosk that are switched in turn while a person is enrolled.
struct LampsConfig {
  std::vector<trigger::GpioOutput> outputs;  ///< none: there are no lamps
  bool active_low = false;
  int each_ms = 400;  ///< that each is on
};

/// One lamp after the other, then none, for one burst; all are off between bursts and after the end. By the
/// pictures' time, from picture to picture: they need not be exposed in step. One thread.
class LampBurst {
 public:
  /// lines  at rest; count: how many
  LampBurst(std::unique_ptr<trigger::TriggerLines> lines, int count, int each_ms);

  int count() const { return count_; }
  double duration_s() const { return static_cast<double>(count_ + 1) * static_cast<double>(each_ns_) * 1e-9; }

  /// The first lamp goes on. now_ns: media time of the newest picture
  void begin(std::int64_t now_ns);
  /// Switches what is due. False: it is over.
  bool go_on(std::int64_t now_ns);
  /// All go off.
  void end();

  bool is_on() const { return step_ >= 0; }
  /// Why a line could not be set in this burst, which was ended by it; else empty.
  const std::string& fault() const { return fault_; }

 private:
  void show(int step);

  std::unique_ptr<trigger::TriggerLines> lines_;
  int count_;
  std::int64_t each_ns_;
  std::int64_t began_ns_ = 0;
  int step_ = -1;  ///< which lamp is on; count_: none, as the room is; -1: there is no burst
  std::string fault_;
};

/// Takes the lines and puts the lamps out. Null where there are none. Throws Error(Unavailable) naming chip,
/// line and who holds it.
std::unique_ptr<LampBurst> open_lamps(const LampsConfig& config);

}  // namespace facet::pipeline
