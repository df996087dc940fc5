#include "service/log.hpp"

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <string>

namespace facet::service {
namespace {

struct LevelText {
  int journal_priority;  // of syslog(3)
  const char* name;
};
constexpr std::array<LevelText, 4> kLevels{{{3, "error"}, {4, "warning"}, {6, "info"}, {7, "debug"}}};

/// systemd names the journal's stream as "device:inode" in JOURNAL_STREAM; it may be inherited by programs
/// whose standard error is something else by now.
bool stderr_is_journal() {
  const char* named = std::getenv("JOURNAL_STREAM");
  struct stat status {};
  return named != nullptr && ::fstat(STDERR_FILENO, &status) == 0 &&
         fmt::format("{}:{}", status.st_dev, status.st_ino) == named;
}

}  // namespace

Log::Log(LogLevel level) : level_(level), to_journal_(stderr_is_journal()) {}

void Log::write(LogLevel level, std::string_view message) const {
  if (level > level_) {
    return;
  }
  const LevelText& text = kLevels.at(static_cast<std::size_t>(level));
  std::string line =
      to_journal_ ? fmt::format("<{}>", text.journal_priority) : fmt::format("facetd: {}: ", text.name);
  for (const char character : message) {
    // One message is one line, whatever a file name holds.
    line += character == '\n' ? ' ' : character;
  }
  line += '\n';
  // One write keeps lines of several threads apart. A log that nobody takes is no reason to stop.
  [[maybe_unused]] const ssize_t ignored = ::write(STDERR_FILENO, line.data(), line.size());
}

}  // namespace facet::service
