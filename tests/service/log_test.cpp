#include "service/log.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>

#include "support/paths.hpp"

namespace facet::service {
namespace {

std::string logged(const Log& log, void (Log::*say)(std::string_view, Log::Fields) const,
                   const char* message) {
  testing::internal::CaptureStderr();
  (log.*say)(message, {});
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

/// Logs as a service whose standard error is the journal, in a child process that has a /run of its own;
/// there, a socket of ours is the journal's where `listens`. What came to either is in files.
class Journal : public ::testing::Test {
 protected:
  /// Returns false where the child may not have a /run of its own.
  bool log_in_child(bool listens, const std::function<void(const Log&)>& work) {
    const pid_t child = ::fork();
    if (child == 0) {
      ::_exit(be_service(listens, work));
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    EXPECT_TRUE(WIFEXITED(status));
    return WEXITSTATUS(status) == 0;
  }
  std::string content(const char* name) const {
    std::ifstream file(folder_.path() / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  }

 private:
  int be_service(bool listens, const std::function<void(const Log&)>& work) const {
    if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("tmpfs", "/run", "tmpfs", 0, "size=1m") != 0) {
      return 1;
    }
    std::filesystem::create_directories("/run/systemd/journal");
    const int receiver = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    sockaddr_un address{AF_UNIX, "/run/systemd/journal/socket"};
    if (listens && ::bind(receiver, reinterpret_cast<sockaddr*>(&address), sizeof(address)) != 0) {
      return 1;
    }
    ::dup2(::open((folder_.path() / "stderr").c_str(), O_WRONLY | O_CREAT, 0600), STDERR_FILENO);
    struct stat status {};
    ::fstat(STDERR_FILENO, &status);
    ::setenv("JOURNAL_STREAM", fmt::format("{}:{}", status.st_dev, status.st_ino).c_str(), 1);
    work(Log());
    std::ofstream entries(folder_.path() / "journal", std::ios::binary);
    std::array<char, 65536> entry{};
    for (ssize_t size = 0; (size = ::recv(receiver, entry.data(), entry.size(), 0)) > 0;) {
      entries.write(entry.data(), size).put('\n');
    }
    return entries.good() ? 0 : 1;
  }

  test::TemporaryFolder folder_;
};

TEST_F(Journal, EntriesHaveFields) {
  if (!log_in_child(true, [](const Log& log) {
        log.error("it hangs", {{"FACET_EVENT", "hang"}, {"FACET_THREAD", "facet-track"}});
        log.debug("below the level");
        log.info("two\nlines");
      })) {
    GTEST_SKIP() << "a /run of the test's own needs root";
  }
  EXPECT_EQ(content("journal"),
            "MESSAGE=it hangs\nPRIORITY=3\nSYSLOG_IDENTIFIER=facetd\nFACET_EVENT=hang\n"
            "FACET_THREAD=facet-track\n\n"
            "MESSAGE=two lines\nPRIORITY=6\nSYSLOG_IDENTIFIER=facetd\n\n");
  EXPECT_EQ(content("stderr"), "");
}

TEST_F(Journal, LinesWithPrioritiesWhereItTakesNoEntries) {
  if (!log_in_child(false, [](const Log& log) {
        log.error("bad", {{"FACET_EVENT", "hang"}});
        log.info("fine");
      })) {
    GTEST_SKIP() << "a /run of the test's own needs root";
  }
  EXPECT_EQ(content("stderr"), "<3>bad\n<6>fine\n");
}

}  // namespace
}  // namespace facet::service
