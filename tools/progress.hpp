#pragma once

#include <chrono>
#include <cstdint>
#include <string>

#include "facet/clock.hpp"

namespace facet::tools {

/// A progress line on standard error: bar, count, rate and time left. On a terminal it redraws in place ten
/// times a second at most; elsewhere (a log, CI) it prints a plain line every ten seconds and one at the end,
/// so that no log fills up. One thread.
class Progress {
 public:
  /// total 0: unknown, shows the count alone. unit: what is counted, in the plural.
  Progress(std::string what, std::uint64_t total, std::string unit = "frames");
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void advance(std::uint64_t by = 1);
  /// Sets the count; `note` is shown behind the bar (a file's name, a figure).
  void set(std::uint64_t done, const std::string& note = {});
  /// Prints the last state with the time taken, once; the destructor calls it.
  void finish();

 private:
  void draw(bool last);

  std::string what_;
  std::string unit_;
  std::string note_;
  std::uint64_t total_;
  std::uint64_t done_ = 0;
  bool terminal_;
  bool finished_ = false;
  Clock::time_point start_;
  Clock::time_point next_draw_;
};

}  // namespace facet::tools
