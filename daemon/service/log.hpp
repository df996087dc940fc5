#pragma once

#include <atomic>
#include <initializer_list>
#include <string_view>
#include <utility>

namespace facet::service {

enum class LogLevel { Error, Warning, Info, Debug };

/// The daemon's log. Where standard error is the systemd journal, messages go to the journal as entries with
/// fields, so that `journalctl FACET_EVENT=hang` finds them; priorities written before lines (the journal's
/// other door, sd-daemon(3)) carry no fields and are what remains where the journal does not take an entry.
/// Elsewhere: whole lines on standard error that begin with the level's name. Any thread; not for the
/// per-frame path.
class Log {
 public:
  /// Names (FACET_..., of A to Z, 0 to 9 and _) and values of an entry's further fields: for the journal
  /// only, the message must say all that people need. docs/operating.md lists them.
  using Fields = std::initializer_list<std::pair<const char*, std::string_view>>;

  explicit Log(LogLevel level = LogLevel::Info);

  void set_level(LogLevel level) { level_ = level; }
  void error(std::string_view message, Fields fields = {}) const { write(LogLevel::Error, message, fields); }
  void warning(std::string_view message, Fields fields = {}) const {
    write(LogLevel::Warning, message, fields);
  }
  void info(std::string_view message, Fields fields = {}) const { write(LogLevel::Info, message, fields); }
  void debug(std::string_view message, Fields fields = {}) const { write(LogLevel::Debug, message, fields); }

 private:
  void write(LogLevel level, std::string_view message, Fields fields) const;

  std::atomic<LogLevel> level_;
  bool to_journal_;
  bool takes_entries_;
};

}  // namespace facet::service
