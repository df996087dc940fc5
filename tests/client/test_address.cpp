// Where libfacet-client connects to, what it says where it can't, and values by their names.

#include <facet-client.h>
#include <gmock/gmock.h>
#include <grp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>

#include "stream/server.hpp"
#include "stream/unix_socket.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"

namespace facet::stream {
namespace {

using testing::HasSubstr;

constexpr int kPatienceMs = 60'000;

struct Free {
  void operator()(facet_client* client) const { facet_client_free(client); }
};
using CClient = std::unique_ptr<facet_client, Free>;

class ClientAddress : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path path = folder.path() / "stream.sock";

  ~ClientAddress() override { ::unsetenv("FACET_SOCKET"); }

  static CClient client_of(const char* socket) {
    CClient client(facet_client_new(socket, FACET_SIGNALS, 0, "test"));
    EXPECT_NE(client, nullptr);
    return client;
  }
  static std::string trouble_at(const char* socket) {
    const CClient client = client_of(socket);
    EXPECT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_UNAVAILABLE);
    return facet_client_message(client.get());
  }
};

TEST_F(ClientAddress, TheEnvironmentNamesTheSocketWhereTheProgramDoesNot) {
  StreamServerConfig config;
  config.socket = path;
  StreamServer server(config);
  server.start();
  server.publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(5, test::patch_subject(), nullptr)));
  ::setenv("FACET_SOCKET", path.c_str(), 1);
  for (const char* socket : {static_cast<const char*>(nullptr), ""}) {
    const CClient client = client_of(socket);
    ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK) << facet_client_message(client.get());
    EXPECT_EQ(facet_client_frame(client.get())->sequence, 5U);
  }
  const std::string other = folder.path() / "other.sock";
  EXPECT_THAT(trouble_at(other.c_str()), HasSubstr(other)) << "a path comes before the environment";
}

TEST_F(ClientAddress, WithoutEnvironmentItIsTheInstalledOne) {
  if (std::filesystem::exists(FACET_DEFAULT_SOCKET)) {
    GTEST_SKIP() << "a daemon is installed here";
  }
  for (const char* value : {static_cast<const char*>(nullptr), ""}) {
    if (value == nullptr) {
      ::unsetenv("FACET_SOCKET");
    } else {
      ::setenv("FACET_SOCKET", value, 1);
    }
    EXPECT_THAT(trouble_at(nullptr), HasSubstr("'" FACET_DEFAULT_SOCKET "'"));
  }
}

TEST_F(ClientAddress, APathOfTheEnvironmentThatIsTooLongIsRefused) {
  ::setenv("FACET_SOCKET", std::string(200, 'x').c_str(), 1);
  EXPECT_EQ(facet_client_new(nullptr, FACET_SIGNALS, 0, nullptr), nullptr);
  EXPECT_EQ(errno, EINVAL);
}

TEST_F(ClientAddress, NobodyAnswersWhereThereIsNoSocketOrNobodyBehindIt) {
  const std::string expected = "nobody answers at the socket '" + path.string() + "'";
  EXPECT_THAT(trouble_at(path.c_str()), HasSubstr(expected));
  { const ListeningSocket gone(path, {}); }
  std::ofstream(path) << "no socket: a connection to it is refused";
  EXPECT_THAT(trouble_at(path.c_str()), HasSubstr(expected));
}

TEST_F(ClientAddress, OtherTroubleIsNamed) {
  const std::string file = folder.path() / "file";
  std::ofstream{file} << "no folder";
  const std::string said = trouble_at((file + "/stream.sock").c_str());
  EXPECT_THAT(said, HasSubstr("Not a directory"));
  EXPECT_THAT(said, testing::Not(HasSubstr("nobody answers")));
}

// The socket itself may not be opened; then not even its folder may be looked into.
TEST_F(ClientAddress, AStrangerIsToldWhichGroupMayConnect) {
  if (::geteuid() != 0) {
    GTEST_SKIP() << "only root can become a stranger";
  }
  const ListeningSocket listening(path, {0660, "video"});
  const auto as_a_stranger = [&] {
    constexpr ::uid_t kNobody = 65534;
    if (::setgroups(0, nullptr) != 0 || ::setgid(kNobody) != 0 || ::setuid(kNobody) != 0) {
      std::fputs("root can't be given up", stderr);
      std::_Exit(2);
    }
    facet_client* client = facet_client_new(path.c_str(), FACET_SIGNALS, 0, "test");
    const int outcome = facet_client_next(client, kPatienceMs);
    std::fputs(facet_client_message(client), stderr);
    std::_Exit(outcome == FACET_UNAVAILABLE ? 7 : 1);
  };
  const std::string expected =
      "no permission for the socket '" + path.string() + "': .* member of the group 'video'";
  ASSERT_EQ(::chmod(folder.path().c_str(), 0755), 0);
  EXPECT_EXIT(as_a_stranger(), testing::ExitedWithCode(7), expected);
  ASSERT_EQ(::chown(folder.path().c_str(), 0, ::getgrnam("video")->gr_gid), 0);
  ASSERT_EQ(::chown(path.c_str(), 0, 0), 0);
  ASSERT_EQ(::chmod(folder.path().c_str(), 0750), 0);
  EXPECT_EXIT(as_a_stranger(), testing::ExitedWithCode(7), expected);
}

TEST_F(ClientAddress, ValuesByTheirNames) {
  StreamServerConfig config;
  config.socket = path;
  StreamServer server(config);
  server.start();
  const CClient client = client_of(path.c_str());
  EXPECT_TRUE(std::isnan(facet_client_expression(client.get(), "jawOpen"))) << "no frame yet";
  server.publish(std::make_shared<mesh::MeshFrame>(test::patch_frame(1, test::patch_subject(), nullptr)));
  ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
  const facet_frame* frame = facet_client_frame(client.get());
  EXPECT_EQ(facet_client_expression(client.get(), "jawOpen"), frame->expression[0]);
  EXPECT_EQ(facet_client_expression(client.get(), "mouthSmileRight"), frame->expression[2]);
  ASSERT_NE(frame->expression[0], frame->expression[2]);
  for (const char* name : {"jawopen", "jawOpe", "jawOpenX", ""}) {
    EXPECT_TRUE(std::isnan(facet_client_expression(client.get(), name))) << name;
  }
  ASSERT_EQ(facet_client_next(client.get(), 0), FACET_TIMEOUT);
  EXPECT_TRUE(std::isnan(facet_client_expression(client.get(), "jawOpen"))) << "no frame any more";
  server.publish(std::make_shared<mesh::MeshFrame>(test::searching_frame(2)));
  ASSERT_EQ(facet_client_next(client.get(), kPatienceMs), FACET_OK);
  EXPECT_TRUE(std::isnan(facet_client_expression(client.get(), "jawOpen"))) << "a frame without a face";
}

}  // namespace
}  // namespace facet::stream
