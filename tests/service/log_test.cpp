#include "service/log.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>

namespace facet::service {
namespace {

std::string logged(const Log& log, void (Log::*say)(std::string_view) const, const char* message) {
  testing::internal::CaptureStderr();
  (log.*say)(message);
  return testing::internal::GetCapturedStderr();
}

TEST(Log, OneMessageIsOneLine) {
  ::unsetenv("JOURNAL_STREAM");
  const Log log;
  EXPECT_EQ(logged(log, &Log::warning, "two\nlines"), "facetd: warning: two lines\n");
}

TEST(Log, LevelsBelowTheSetOneAreSilent) {
  Log log(LogLevel::Warning);
  EXPECT_EQ(logged(log, &Log::info, "quiet"), "");
  EXPECT_NE(logged(log, &Log::error, "loud"), "");
  log.set_level(LogLevel::Debug);
  EXPECT_NE(logged(log, &Log::debug, "all"), "");
}

TEST(Log, TheJournalGetsPriorities) {
  testing::internal::CaptureStderr();
  struct stat status {};
  ASSERT_EQ(::fstat(STDERR_FILENO, &status), 0);
  ::setenv("JOURNAL_STREAM", fmt::format("{}:{}", status.st_dev, status.st_ino).c_str(), 1);
  const Log log;
  ::unsetenv("JOURNAL_STREAM");
  log.error("bad");
  log.info("fine");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "<3>bad\n<6>fine\n");
}

}  // namespace
}  // namespace facet::service
