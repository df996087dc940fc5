#include "progress.hpp"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "facet/clock.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
constexpr auto kTerminalPeriod = 100ms;
constexpr auto kLogPeriod = 10s;
constexpr int kBarWidth = 24;

std::string duration_text(double seconds) {
  const auto whole = std::lround(std::max(0.0, seconds));
  return whole >= 3600 ? fmt::format("{}:{:02}:{:02}", whole / 3600, whole / 60 % 60, whole % 60)
                       : fmt::format("{}:{:02}", whole / 60, whole % 60);
}

int terminal_columns() {
  winsize size{};
  return ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

}  // namespace

Progress::Progress(std::string what, std::uint64_t total, std::string unit)
    : what_(std::move(what)),
      unit_(std::move(unit)),
      total_(total),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(Clock::now()),
      next_draw_(start_ + (terminal_ ? 0s : kLogPeriod)) {}

Progress::~Progress() {
  finish();
}

void Progress::advance(std::uint64_t by) {
  set(done_ + by, note_);
}

void Progress::set(std::uint64_t done, const std::string& note) {
  done_ = done;
  note_ = note;
  if (!finished_ && Clock::now() >= next_draw_) {
    draw(false);
  }
}

void Progress::finish() {
  if (!finished_) {
    finished_ = true;
    draw(true);
  }
}

void Progress::draw(bool last) {
  const auto now = Clock::now();
  next_draw_ = now + (terminal_ ? Clock::duration(kTerminalPeriod) : Clock::duration(kLogPeriod));
  const double elapsed_s = std::chrono::duration<double>(now - start_).count();
  const double rate_hz = elapsed_s > 0 ? static_cast<double>(done_) / elapsed_s : 0;

  std::string line = what_ + "  ";
  if (total_ > 0) {
    const double part = std::min(1.0, static_cast<double>(done_) / static_cast<double>(total_));
    if (terminal_) {
      const int filled = static_cast<int>(part * kBarWidth);
      line += fmt::format("[{}{}] ", std::string(static_cast<std::size_t>(filled), '#'),
                          std::string(static_cast<std::size_t>(kBarWidth - filled), '.'));
    }
    line += fmt::format("{:3.0f} %  {}/{} {}", 100 * part, done_, total_, unit_);
  } else {
    line += fmt::format("{} {}", done_, unit_);
  }
  if (last) {
    line += fmt::format("  in {}", duration_text(elapsed_s));
  } else if (total_ > done_ && rate_hz > 0) {
    line += fmt::format("  {:.1f}/s  {} left", rate_hz,
                        duration_text(static_cast<double>(total_ - done_) / rate_hz));
  }
  if (!note_.empty()) {
    line += "  " + note_;
  }
  if (terminal_) {
    line.resize(std::min(line.size(), static_cast<std::size_t>(terminal_columns() - 1)));
    tell(stderr, "\r{}\x1b[K", line);
    if (last) {
      tell(stderr, "\n");
    }
  } else {
    tell(stderr, "{}\n", line);
  }
  std::fflush(stderr);
}

}  // namespace facet::tools
