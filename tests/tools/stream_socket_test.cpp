// Which socket `facet watch` and `facet play` take: what is named by an option, by a configuration, by
// FACET_SOCKET.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "stream/client.hpp"
#include "stream/server.hpp"
#include "support/child_process.hpp"
#include "support/eventually.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/take_actor.hpp"

namespace facet::tools {
namespace {

using ::testing::HasSubstr;

class StreamSocket : public ::testing::Test {
 protected:
  std::string file(const std::string& name) const { return folder_.path() / name; }
  std::string config(const std::string& socket) {
    std::ofstream(file("facet.toml")) << "[stream]\nsocket = '" << file(socket) << "'\n";
    return file("facet.toml");
  }
  /// A server whose only frame has this number.
  std::unique_ptr<stream::StreamServer> serve(const std::string& socket, std::uint64_t sequence) const {
    stream::StreamServerConfig config;
    config.socket = file(socket);
    auto server = std::make_unique<stream::StreamServer>(config);
    server->start();
    server->publish(
        std::make_shared<mesh::MeshFrame>(test::patch_frame(sequence, test::patch_subject(), nullptr)));
    return server;
  }
  int watch(const std::vector<std::string>& named, const std::string& environment) {
    std::vector<std::string> arguments = {"watch", "--json", "--frames", "1"};
    arguments.insert(arguments.end(), named.begin(), named.end());
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log",
                             {{"FACET_SOCKET=" + environment}});
    const int status = child.wait();
    output_ = child.output();
    return status;
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(StreamSocket, AnOptionComesBeforeTheEnvironmentAndThatBeforeWhatIsInstalled) {
  const auto one = serve("one.sock", 101);
  const auto two = serve("two.sock", 202);
  EXPECT_EQ(watch({}, file("one.sock")), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("101"));
  EXPECT_EQ(watch({"--socket", file("two.sock")}, file("one.sock")), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("202"));
  EXPECT_EQ(watch({"--config", config("two.sock")}, file("one.sock")), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("202"));
  EXPECT_EQ(watch({"--config", config("two.sock"), "--socket", file("one.sock")}, ""), 2) << "which of both?";
  EXPECT_EQ(watch({}, file("nobody.sock")), static_cast<int>(ErrorKind::Unavailable));
  EXPECT_THAT(output_, HasSubstr("nobody answers at the socket '" + file("nobody.sock") + "'"));
}

TEST_F(StreamSocket, ATakeIsPlayedWhereItIsLookedFor) {
  const std::string take = test::record_actor(folder_.path(), 1, 20);
  const std::vector<std::vector<std::string>> named = {{}, {"--config", config("played.sock")}};
  for (const auto& options : named) {
    std::vector<std::string> arguments = {"play", take, "--loop"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const std::string environment = "FACET_SOCKET=" + file(options.empty() ? "played.sock" : "other.sock");
    test::ChildProcess player(FACET_PROGRAM, arguments, folder_.path() / "player", {{environment}});
    ASSERT_TRUE(test::eventually([&] { return std::filesystem::exists(file("played.sock")); }))
        << player.output();
    EXPECT_EQ(watch({}, file("played.sock")), 0) << output_;
    EXPECT_FALSE(std::filesystem::exists(file("other.sock")));
    player.send(SIGTERM);
    player.wait();
  }
}

}  // namespace
}  // namespace facet::tools
