#pragma once

#include <atomic>
#include <string_view>

namespace facet::service {

enum class LogLevel { Error, Warning, Info, Debug };

/// The daemon's log: whole lines on standard error. Where standard error is the systemd journal each line
/// begins with the journal's priority, "<4>", else with the level's name. Any thread; not for the per-frame
/// path.
class Log {
 public:
  explicit Log(LogLevel level = LogLevel::Info);

  void set_level(LogLevel level) { level_ = level; }
  void error(std::string_view message) const { write(LogLevel::Error, message); }
  void warning(std::string_view message) const { write(LogLevel::Warning, message); }
  void info(std::string_view message) const { write(LogLevel::Info, message); }
  void debug(std::string_view message) const { write(LogLevel::Debug, message); }

 private:
  void write(LogLevel level, std::string_view message) const;

  std::atomic<LogLevel> level_;
  bool to_journal_;
};

}  // namespace facet::service
