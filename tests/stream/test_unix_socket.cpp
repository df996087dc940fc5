#include <fcntl.h>
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <optional>

#include "facet/error.hpp"
#include "stream/unix_socket.hpp"
#include "support/paths.hpp"

namespace facet::stream {
namespace {

using testing::HasSubstr;

class UnixSocket : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path path = folder.path() / "stream.sock";

  static void expect_error(ErrorKind kind, const std::string& part, auto&& work) {
    try {
      work();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), kind);
      EXPECT_THAT(error.what(), HasSubstr(part));
      return;
    }
    ADD_FAILURE() << "no error, expected one with: " << part;
  }
};

TEST_F(UnixSocket, ListensAndCleansUp) {
  {
    const ListeningSocket listening(path, {});
    EXPECT_TRUE(connect_unix(path));
  }
  EXPECT_FALSE(std::filesystem::exists(path));
  expect_error(ErrorKind::Unavailable, "nobody answers", [&] { connect_unix(path); });
}

TEST_F(UnixSocket, StaleSocketIsReplaced) {
  const std::filesystem::path kept = folder.path() / "kept.sock";
  {
    const ListeningSocket crashed(path, {});
    // A hard link survives the owner's clean-up as a crash's leftover would.
    std::filesystem::create_hard_link(path, kept);
  }
  ASSERT_TRUE(std::filesystem::is_socket(kept));
  const ListeningSocket listening(kept, {});
  EXPECT_TRUE(connect_unix(kept));
}

/// With no descriptor left a connection is closed instead of waking the loop without end.
TEST_F(UnixSocket, WhoCanNotBeAcceptedIsTurnedAway) {
  ListeningSocket listening(path, {});
  const FileDescriptor first = connect_unix(path);
  const FileDescriptor second = connect_unix(path);
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const FileDescriptor highest(::fcntl(second.get(), F_DUPFD_CLOEXEC, 0));
  const rlimit none{static_cast<rlim_t>(highest.get()) + 1, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &none), 0);
  EXPECT_FALSE(listening.accept());
  EXPECT_FALSE(listening.accept());
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_EQ(listening.turned_away(), 2U);
  char byte = 0;
  EXPECT_EQ(::recv(first.get(), &byte, 1, 0), 0) << "it is told by its end";
  pollfd waits{listening.fd(), POLLIN, 0};
  EXPECT_EQ(::poll(&waits, 1, 0), 0) << "nobody is left in the backlog";
  const FileDescriptor third = connect_unix(path);
  EXPECT_TRUE(listening.accept());
  EXPECT_EQ(listening.turned_away(), 2U);
}

TEST_F(UnixSocket, APassedSocketIsUsedAndItsPathLeftAlone) {
  ListeningSocket manager(path, {});
  {
    const ListeningSocket passed(path.parent_path() / "." / path.filename(), {},
                                 FileDescriptor(::dup(manager.fd())));
    EXPECT_NE(passed.fd(), manager.fd());
    EXPECT_TRUE(connect_unix(path));
    EXPECT_TRUE(FileDescriptor(::accept(passed.fd(), nullptr, nullptr)));
    EXPECT_EQ(::accept(passed.fd(), nullptr, nullptr), -1) << "it doesn't block";
  }
  EXPECT_TRUE(connect_unix(path)) << "it belongs to the one who passed it";
}

TEST_F(UnixSocket, APassedSocketMustBeTheOneThatIsConfigured) {
  const ListeningSocket manager(path, {});
  expect_error(ErrorKind::Usage, path.string(), [&] {
    const ListeningSocket other(folder.path() / "other.sock", {}, FileDescriptor(::dup(manager.fd())));
  });
  expect_error(ErrorKind::Usage, "not a listening Unix stream socket", [&] {
    const ListeningSocket silent(path, {}, FileDescriptor(::socket(AF_UNIX, SOCK_STREAM, 0)));
  });
  expect_error(ErrorKind::Usage, "not a listening Unix stream socket",
               [&] { const ListeningSocket file(path, {}, FileDescriptor(::dup(STDERR_FILENO))); });
}

TEST_F(UnixSocket, RunningServersSocketIsLeftAlone) {
  const ListeningSocket first(path, {});
  expect_error(ErrorKind::Storage, "in use", [&] { const ListeningSocket second(path, {}); });
  EXPECT_TRUE(connect_unix(path));
}

TEST_F(UnixSocket, OtherFilesAreNeverRemoved) {
  std::ofstream(path) << "precious";
  expect_error(ErrorKind::Storage, "not a socket", [&] { const ListeningSocket listening(path, {}); });
  EXPECT_TRUE(std::filesystem::is_regular_file(path));
}

TEST_F(UnixSocket, SuccessorsSocketIsNotRemoved) {
  std::optional<ListeningSocket> first(std::in_place, path, SocketAccess{});
  std::filesystem::remove(path);
  const ListeningSocket second(path, {});
  first.reset();
  EXPECT_TRUE(connect_unix(path));
}

TEST_F(UnixSocket, MissingFolderAndLongPathAreNamed) {
  expect_error(ErrorKind::Storage, "does not exist",
               [&] { const ListeningSocket listening(folder.path() / "no/such.sock", {}); });
  expect_error(ErrorKind::Usage, "shorter",
               [&] { const ListeningSocket listening(folder.path() / std::string(200, 'x'), {}); });
}

TEST_F(UnixSocket, ModeIsSetAndUnknownGroupIsNamed) {
  {
    const ListeningSocket listening(path, {0600, ""});
    struct stat status {};
    ASSERT_EQ(::stat(path.c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777U, 0600U);
  }
  expect_error(ErrorKind::Usage, "no-such-group-here", [&] {
    const ListeningSocket listening(path, {0660, "no-such-group-here"});
  });
  EXPECT_FALSE(std::filesystem::exists(path)) << "a failed start left its socket behind";
}

TEST_F(UnixSocket, ClosedFolderIsNamed) {
  if (::geteuid() == 0) {
    GTEST_SKIP() << "root may write everywhere";
  }
  ::chmod(folder.path().c_str(), 0500);
  expect_error(ErrorKind::Storage, "cannot write to the folder",
               [&] { const ListeningSocket listening(path, {}); });
  ::chmod(folder.path().c_str(), 0700);
}

TEST_F(UnixSocket, AStrangerToTheGroupIsKeptOutAndToldWhichItIs) {
  if (::geteuid() != 0) {
    GTEST_SKIP() << "only root can become a stranger";
  }
  ASSERT_EQ(::chmod(folder.path().c_str(), 0755), 0);
  const ListeningSocket listening(path, {0660, "video"});
  const auto as_a_stranger = [&] {
    constexpr ::uid_t kNobody = 65534;
    if (::setgroups(0, nullptr) != 0 || ::setgid(kNobody) != 0 || ::setuid(kNobody) != 0) {
      std::fputs("root can't be given up", stderr);
      std::_Exit(2);
    }
    try {
      const FileDescriptor fd = connect_unix(path);
      std::fputs("it was let in", stderr);
    } catch (const Error& error) {
      std::fputs(error.what(), stderr);
      std::_Exit(error.kind() == ErrorKind::Unavailable ? 7 : 1);
    }
    std::_Exit(0);
  };
  EXPECT_EXIT(as_a_stranger(), testing::ExitedWithCode(7), "no permission .* member of the group 'video'");
}

}  // namespace
}  // namespace facet::stream
