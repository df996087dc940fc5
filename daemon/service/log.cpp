#include "service/log.hpp"

#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <string>
#include <vector>

// The place in the source is no use to whoever reads the journal.
#define SD_JOURNAL_SUPPRESS_LOCATION
#include <systemd/sd-journal.h>

#include "facet/printable.hpp"

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

/// sd_journal_sendv(3) keeps silent where there is no journal, as for a service with a root folder of its
/// own.
bool journal_takes_entries() {
  return ::access("/run/systemd/journal/socket", W_OK) == 0;
}

bool send_to_journal(int priority, const std::string& message, Log::Fields fields) {
  std::vector<std::string> texts = {"MESSAGE=" + message, fmt::format("PRIORITY={}", priority),
                                    "SYSLOG_IDENTIFIER=facetd"};
  for (const auto& [name, value] : fields) {
    texts.push_back(fmt::format("{}={}", name, value));
  }
  std::vector<iovec> parts;
  parts.reserve(texts.size());
  for (std::string& text : texts) {
    parts.push_back({text.data(), text.size()});
  }
  return ::sd_journal_sendv(parts.data(), static_cast<int>(parts.size())) == 0;
}

}  // namespace

Log::Log(LogLevel level)
    : level_(level),
      to_journal_(stderr_is_journal()),
      takes_entries_(to_journal_ && journal_takes_entries()) {}

void Log::write(LogLevel level, std::string_view message, Fields fields) const {
  if (level > level_) {
    return;
  }
  const LevelText& text = kLevels.at(static_cast<std::size_t>(level));
  std::string line(message);
  // One message is one line, whatever a file name holds, and it steers no terminal.
  std::replace(line.begin(), line.end(), '\n', ' ');
  line = printable(line);
  if (takes_entries_ && send_to_journal(text.journal_priority, line, fields)) {
    return;
  }
  line.insert(
      0, to_journal_ ? fmt::format("<{}>", text.journal_priority) : fmt::format("facetd: {}: ", text.name));
  line += '\n';
  // One write keeps lines of several threads apart. A log that nobody takes is no reason to stop.
  [[maybe_unused]] const ssize_t ignored = ::write(STDERR_FILENO, line.data(), line.size());
}

}  // namespace facet::service
