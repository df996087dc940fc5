#include "service/control_server.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <atomic>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "facet/error.hpp"
#include "service/control_client.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// A control server with its own loop on a thread.
class Served {
 public:
  explicit Served(const ControlConfig& config) : server_(config, methods()), thread_([this] { loop(); }) {}
  ~Served() {
    stop_ = true;
    thread_.join();
  }
  std::size_t clients() const { return clients_; }

 private:
  static ControlMethods methods() {
    return {{"look",
             {false,
              {},
              [](const json&) {
                return json{{"seen", true}};
              }}},
            {"big", {false, {}, [](const json&) { return json(std::string(1 << 20, 'x')); }}},
            {"change", {true, {"name"}, [](const json& params) { return params; }}},
            {"full", {true, {}, [](const json&) -> json { throw Error(ErrorKind::Storage, "disk full"); }}}};
  }
  void loop() {
    while (!stop_) {
      pollfd event{server_.fd(), POLLIN, 0};
      ::poll(&event, 1, 10);
      server_.serve();
      clients_ = server_.client_count();
    }
  }

  ControlServer server_;
  std::atomic<bool> stop_{false};
  std::atomic<std::size_t> clients_{0};
  std::thread thread_;
};

class ControlServerTest : public ::testing::Test {
 protected:
  ControlConfig config() const {
    ControlConfig config;
    config.socket = folder_.path() / "control.sock";
    return config;
  }
  void expect_clients(const Served& served, std::size_t count) const {
    for (int i = 0; i < 500 && served.clients() != count; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    EXPECT_EQ(served.clients(), count);
  }
  test::TemporaryFolder folder_;
};

TEST_F(ControlServerTest, AnswersManyClients) {
  const Served served(config());
  std::vector<std::unique_ptr<ControlClient>> clients;
  for (int i = 0; i < 20; ++i) {
    clients.push_back(std::make_unique<ControlClient>(config().socket));
  }
  for (int round = 0; round < 3; ++round) {
    for (const auto& client : clients) {
      EXPECT_EQ(client->call("look", json::object()), json({{"seen", true}}));
    }
  }
  EXPECT_EQ(clients[0]->call("change", {{"name", "x"}}), json({{"name", "x"}}));
  EXPECT_EQ(clients[0]->call("big", json::object()).get<std::string>().size(), 1U << 20);
  clients.clear();
  expect_clients(served, 0);
}

TEST_F(ControlServerTest, ErrorsReachTheClientWithTheirKind) {
  const Served served(config());
  ControlClient client(config().socket);
  try {
    client.call("full", json::object());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_STREQ(error.what(), "disk full");
  }
  try {
    client.call("change", {{"nam", "x"}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
  }
}

TEST_F(ControlServerTest, RequestsMayComeInPiecesOrSeveralAtOnce) {
  const Served served(config());
  const stream::FileDescriptor fd = stream::connect_unix(config().socket);
  const std::string two = R"({"jsonrpc":"2.0","method":"look","id":1})"
                          "\r\n\n"
                          R"({"jsonrpc":"2.0","method":"look","id":2})"
                          "\n";
  for (const char character : two) {
    ASSERT_EQ(::send(fd.get(), &character, 1, 0), 1);
  }
  std::string answers;
  while (std::count(answers.begin(), answers.end(), '\n') < 2) {
    std::array<char, 256> piece{};
    const ssize_t count = ::recv(fd.get(), piece.data(), piece.size(), 0);
    ASSERT_GT(count, 0);
    answers.append(piece.data(), static_cast<std::size_t>(count));
  }
  EXPECT_THAT(answers, HasSubstr("\"id\":1"));
  EXPECT_THAT(answers, HasSubstr("\"id\":2"));
}

TEST_F(ControlServerTest, ALineTooLongIsRefusedAndItsClientDropped) {
  const Served served(config());
  const stream::FileDescriptor fd = stream::connect_unix(config().socket);
  const std::string endless(2 * kMaxRequestBytes, 'x');
  // The server may hang up in the middle.
  [[maybe_unused]] const ssize_t sent = ::send(fd.get(), endless.data(), endless.size(), MSG_NOSIGNAL);
  std::string answer;
  std::array<char, 256> piece{};
  for (ssize_t count = 1; count > 0;) {
    count = ::recv(fd.get(), piece.data(), piece.size(), 0);
    answer.append(piece.data(), count > 0 ? static_cast<std::size_t>(count) : 0);
  }
  EXPECT_THAT(answer, HasSubstr("-32600"));
  expect_clients(served, 0);
}

TEST_F(ControlServerTest, AClientThatNeverReadsHoldsUpNobody) {
  const Served served(config());
  const stream::FileDescriptor greedy = stream::connect_unix(config().socket);
  std::string requests;
  for (int i = 0; i < 100; ++i) {
    requests += R"({"jsonrpc":"2.0","method":"big","id":1})"
                "\n";
  }
  ASSERT_EQ(::send(greedy.get(), requests.data(), requests.size(), MSG_NOSIGNAL),
            static_cast<ssize_t>(requests.size()));
  ControlClient other(config().socket);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(other.call("look", json::object()), json({{"seen", true}}));
  }
}

TEST_F(ControlServerTest, TooManyClientsAreTold) {
  const Served served(config());
  std::vector<stream::FileDescriptor> many;
  for (std::size_t i = 0; i < ControlServer::kMaxClients; ++i) {
    many.push_back(stream::connect_unix(config().socket));
  }
  expect_clients(served, ControlServer::kMaxClients);
  ControlClient late(config().socket);
  try {
    late.call("look", json::object());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
  }
  many.clear();
  expect_clients(served, 0);
  EXPECT_EQ(ControlClient(config().socket).call("look", json::object()), json({{"seen", true}}));
}

TEST_F(ControlServerTest, PathTakenAndStalePath) {
  {
    const Served served(config());
    EXPECT_THROW(ControlServer(config(), {}), Error);
    EXPECT_EQ(ControlClient(config().socket).call("look", json::object()), json({{"seen", true}}));
  }
  EXPECT_FALSE(std::filesystem::exists(config().socket));
  std::ofstream(config().socket) << "not a socket";
  try {
    const ControlServer server(config(), {});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), HasSubstr(config().socket.string()));
  }
}

TEST_F(ControlServerTest, ModeAndGroup) {
  ControlConfig closed = config();
  closed.access.mode = 0600;
  const ControlServer server(closed, {});
  struct stat status {};
  ASSERT_EQ(::stat(closed.socket.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0600U);
  ControlConfig unknown = config();
  unknown.socket = folder_.path() / "other.sock";
  unknown.access.group = "no-such-group-here";
  EXPECT_THROW(ControlServer(unknown, {}), Error);
}

TEST_F(ControlServerTest, ClientSaysThatNobodyAnswers) {
  try {
    ControlClient client(config().socket);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), HasSubstr(config().socket.string()));
  }
}

}  // namespace
}  // namespace facet::service
