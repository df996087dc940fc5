// How the daemon's start ends when something is short, when it is missing, and when a signal comes.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>

#include "daemon_fixture.hpp"
#include "facet/system_error.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {
namespace {

using ::testing::AnyOf;
using ::testing::Not;

TEST(SystemError, WhatMayPassIsTriedAgain) {
  for (const int passing : {EAGAIN, EINTR, EIO, EMFILE, ENFILE, ENOMEM}) {
    EXPECT_EQ(kind_of_errno(passing), ErrorKind::Unavailable) << passing;
    EXPECT_THAT(describe_errno(passing), HasSubstr("another try may help"));
  }
  for (const int lasting : {ENOENT, EACCES, EISDIR, EINVAL, ENOTDIR, 0, -541478725 /*AVERROR_EOF*/}) {
    EXPECT_EQ(kind_of_errno(lasting), ErrorKind::UnreadableInput) << lasting;
  }
  EXPECT_EQ(kind_of_errno(ENOSPC, ErrorKind::Storage), ErrorKind::Storage);
}

/// A start in which one call fails.
class ShortOfSomething : public DaemonWithAssets {
 protected:
  void SetUp() override {
#ifdef FACET_SANITIZED
    GTEST_SKIP() << "a sanitizer's library wants to be the first that is loaded";
#endif
    DaemonWithAssets::SetUp();
  }

  struct End {
    int status = 0;
    bool failed = false;  ///< the call came
    std::string output;
  };
  End end_of(const std::string& fault) {
    // The source ends by itself, so that a daemon whom the fault does not hurt ends too.
    const std::string config = configure(grey_source(3) + "\nexit_at_end = true");
    std::ofstream(config, std::ios::app)
        << "[web]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"" << token().string() << "\"\n";
    End end;
    end.status = run({"--config", config}, end.output,
                     {.environment = {std::string("LD_PRELOAD=") + START_FAULT, "FACET_FAIL=" + fault},
                      .pending_signal = 0});
    end.failed = end.output.find("start_fault: done") != std::string::npos;
    return end;
  }
  std::filesystem::path token() const {
    return folder_.path() / "token";
  }

  /// Every n-th call of a kind, until there are no more. None may end in a status that nobody tries again.
  /// (An end by a signal is tried again: libgcrypt, which the journal's library brings, aborts before main
  /// where it can't open a file.)
  void sweep(const std::string& call, int error, int most) {
    int count = 0;
    for (bool failed = true; failed; ++count) {
      ASSERT_LT(count, most) << "calls of " << call;
      const End end = end_of(fmt::format("{} {} {}", call, count + 1, error));
      failed = end.failed;
      EXPECT_THAT(end.status, Not(AnyOf(2, 3))) << call << " " << count + 1 << ": " << end.output;
    }
    EXPECT_GT(count, 3) << "calls of " << call;
  }
};

TEST_F(ShortOfSomething, EndsInAStatusThatIsTriedAgain) {
  struct Case {
    const char* call;
    int error;
    const char* file;
  };
  for (const Case& shortage :
       {Case{"open", EMFILE, ".facemodel"}, Case{"open", ENFILE, "face_mesh_solution"},
        Case{"read", EIO, "face_mesh_solution"}, Case{"open", EMFILE, "grey.mkv"},
        Case{"read", EIO, "grey.mkv"}, Case{"open", EMFILE, "facet.toml"}, Case{"read", EIO, "facet.toml"}}) {
    const End end = end_of(fmt::format("{} 1 {} {}", shortage.call, shortage.error, shortage.file));
    ASSERT_TRUE(end.failed) << shortage.file;
    EXPECT_EQ(end.status, static_cast<int>(ErrorKind::Unavailable)) << shortage.file << ": " << end.output;
    EXPECT_THAT(end.output, AllOf(HasSubstr(shortage.file), HasSubstr(describe_errno(shortage.error))));
  }
}

TEST_F(ShortOfSomething, EveryOpenOfTheStart) {
  sweep("open", EMFILE, 400);
}

TEST_F(ShortOfSomething, EveryThreadOfTheStart) {
  sweep("thread", EAGAIN, 100);
}

TEST_F(ShortOfSomething, ThePageIsTriedAgain) {
  const std::string config = configure(looped(), "", "none");
  std::ofstream(config, std::ios::app)
      << "[web]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"" << token().string() << "\"\n";
  const auto daemon = start(config, {.environment = {std::string("LD_PRELOAD=") + START_FAULT,
                                                     fmt::format("FACET_FAIL=open 1 {} token", EMFILE)},
                                     .pending_signal = 0});
  const json status = await(*daemon, [](const json& now) { return !now["web"].is_null(); });
  EXPECT_THAT(daemon->output(), AllOf(HasSubstr("start_fault: done"), HasSubstr("web.token_file")));
  EXPECT_TRUE(std::filesystem::exists(token()));
  daemon->send(SIGTERM);
  expect_end(*daemon);
}

TEST_F(DaemonWithAssets, MetricsComeOnceTheirPortIsFree) {
  std::optional<stream::FileDescriptor> other{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t length = sizeof(address);
  auto* bound = reinterpret_cast<sockaddr*>(&address);
  ASSERT_EQ(::bind(other->get(), bound, length), 0);
  ASSERT_EQ(::listen(other->get(), 1), 0);
  ASSERT_EQ(::getsockname(other->get(), bound, &length), 0);
  const std::string config = configure(looped(), "", "none");
  std::string text = (std::ostringstream() << std::ifstream(config).rdbuf()).str();
  const std::string none = "[metrics]\nlisten = \"\"";
  ASSERT_NE(text.find(none), std::string::npos);
  text.replace(text.find(none), none.size(),
               fmt::format("[metrics]\nlisten = \"127.0.0.1:{}\"", ntohs(address.sin_port)));
  std::ofstream(config) << text;
  const auto daemon = start(config);
  await(*daemon, [&](const json&) { return daemon->output().find("metrics.listen") != std::string::npos; });
  EXPECT_THAT(daemon->output(), Not(HasSubstr("metrics on http")));
  other.reset();
  await(*daemon, [&](const json&) { return daemon->output().find("metrics on http") != std::string::npos; });
  daemon->send(SIGTERM);
  expect_end(*daemon);
}

TEST_F(DaemonWithAssets, WhatIsNotThereStaysSo) {
  std::string output;
  EXPECT_EQ(run({"--config", configure("path = \"none.mp4\"")}, output), 3);
  EXPECT_EQ(run({"--config", configure(looped(), "", "none", folder_.path() / "none.facemodel")}, output), 3);
  EXPECT_THAT(output, AllOf(HasSubstr("none.facemodel"), HasSubstr("facet model build")));
  EXPECT_EQ(run({"--config", (folder_.path() / "none.toml").string()}, output), 3);
}

TEST_F(DaemonWithAssets, AHangUpIsNoEnd) {
  const auto daemon = start(configure(looped()), {.environment = {}, .pending_signal = SIGHUP});
  await(*daemon, is_running);
  daemon->send(SIGHUP);
  await(*daemon, [&](const json&) {
    const std::string said = daemon->output();
    return said.find("SIGHUP", said.find("SIGHUP") + 1) != std::string::npos;
  });
  EXPECT_THAT(daemon->output(), HasSubstr("SIGHUP is ignored"));
  daemon->send(SIGTERM);
  expect_end(*daemon);
}

}  // namespace
}  // namespace facet::service
