#include "service/control_server.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "facet/error.hpp"
#include "service/control_client.hpp"
#include "support/full_queue.hpp"
#include "support/paths.hpp"

namespace facet::service {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;
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
            {"change", {true, {{"name"}}, [](const json& params) { return params; }}},
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
  /// One line without its end; "" once the server has closed the connection.
  static std::string receive_line(const stream::FileDescriptor& fd) {
    std::string line;
    std::array<char, 65536> piece{};
    while (line.empty() || line.back() != '\n') {
      const ssize_t count = ::recv(fd.get(), piece.data(), piece.size(), 0);
      if (count <= 0) {
        return line;
      }
      line.append(piece.data(), static_cast<std::size_t>(count));
    }
    line.pop_back();
    return line;
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

/// A request that echoes text, with as much of it as makes the line this long.
std::string line_of(std::size_t bytes) {
  const std::string start = R"({"jsonrpc":"2.0","id":7,"method":"change","params":{"name":")";
  const std::string end = R"("}})";
  std::string text(bytes - start.size() - end.size(), 'x');
  text.back() = '!';
  return start + text + end + "\n";
}

TEST_F(ControlServerTest, RequestLinesUpToTheLimitAreAnswered) {
  const Served served(config());
  const stream::FileDescriptor fd = stream::connect_unix(config().socket);
  for (const std::size_t bytes :
       {std::size_t{65'535}, std::size_t{65'537}, kMaxRequestBytes - 1, kMaxRequestBytes}) {
    const std::string request = line_of(bytes);
    ASSERT_EQ(request.size(), bytes + 1);
    ASSERT_EQ(::send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(request.size()));
    const std::string answer = receive_line(fd);
    const json echoed = json::parse(answer, nullptr, false);
    ASSERT_TRUE(echoed.contains("result")) << answer.substr(0, 200);
    EXPECT_EQ(echoed["id"], 7);
    EXPECT_EQ(echoed["result"], json::parse(request)["params"]) << bytes;
  }
}

TEST_F(ControlServerTest, ALineTooLongIsRefusedAndItsClientDropped) {
  const Served served(config());
  for (const std::size_t bytes : {kMaxRequestBytes + 1, kMaxRequestBytes + 10'000, 2 * kMaxRequestBytes}) {
    const stream::FileDescriptor fd = stream::connect_unix(config().socket);
    const std::string request = line_of(bytes);
    // The server may hang up in the middle.
    [[maybe_unused]] const ssize_t sent = ::send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL);
    const json told = json::parse(receive_line(fd), nullptr, false);
    ASSERT_TRUE(told.contains("error")) << bytes;
    EXPECT_EQ(told["error"]["code"], kInvalidRequest);
    EXPECT_EQ(told["error"]["message"], "a request line has 1048576 bytes at most");
    EXPECT_TRUE(told["id"].is_null());
    EXPECT_EQ(receive_line(fd), "") << "nothing follows";
    expect_clients(served, 0);
  }
  // Programs that use the client are told the same.
  ControlClient client(config().socket);
  try {
    client.call("change", {{"name", std::string(3 * kMaxRequestBytes, 'x')}});
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("1048576 bytes at most"));
  }
  EXPECT_EQ(ControlClient(config().socket).call("look", json::object()), json({{"seen", true}}));
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
    ControlClient(config().socket).call("look", json::object());
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), HasSubstr(config().socket.string()));
  }
}

TEST_F(ControlServerTest, ClientWaitsForAStoppedDaemonNoLongerThanItIsToldTo) {
  const stream::ListeningSocket stopped(config().socket, {});
  const auto silence = [&] {
    try {
      ControlClient(config().socket, 50ms).call("look", json::object());
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(silence(), HasSubstr("gave no answer for 50 ms"));
  const auto queued = test::fill_queue(config().socket);
  EXPECT_THAT(silence(), HasSubstr("does not answer"));
}

TEST_F(ControlServerTest, ClientWaitsForAWholeAnswerAndNotForEachPieceOfIt) {
  const stream::ListeningSocket slow(config().socket, {});
  std::thread daemon([&] {
    pollfd entry{slow.fd(), POLLIN, 0};
    ::poll(&entry, 1, -1);
    const stream::FileDescriptor connection(::accept(slow.fd(), nullptr, nullptr));
    while (::send(connection.get(), " ", 1, MSG_NOSIGNAL) == 1) {
      std::this_thread::sleep_for(1ms);
    }
  });
  try {
    ControlClient(config().socket, 100ms).call("look", json::object());
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("no whole answer for 100 ms"));
  }
  daemon.join();
}

}  // namespace
}  // namespace facet::service
